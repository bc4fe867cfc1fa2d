//! `--error-against`: how far a picture is from a truer one, beside the time that it took.

use super::progress::Progress;
use super::reference::{References, Truths};
use super::run::Session;
use super::{CommandError, SceneArgs};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;
use tessera_geometry::{CameraPose, linear_from_srgb};
use tessera_master::compare::{Kind, Picture, compare};
use tessera_master::report::{ErrorReport, ErrorStep};
use tessera_master::{FrameBuffer, FrameJob, FrameResult, OutputFile, PixelFormat, prepare};
use tessera_oracle::View;
use tessera_pack::Plain;
use tessera_wire::{Sampling, limits};

/// What a picture is compared with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Against {
    /// A picture in a file.
    File(PathBuf),
    /// The same frame of plain vertices.
    Plain,
    /// The same frame with so many samples a pixel.
    Samples(u32),
    /// What the oracle sees with so many samples a pixel.
    Oracle(u32),
}

impl FromStr for Against {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let samples = |count: &str| {
            let count = count.parse().ok().filter(|count| (1..=limits::SAMPLES).contains(count));
            count.ok_or_else(|| {
                format!("{text}: write 1 to {} samples a pixel, as in spp:256", limits::SAMPLES)
            })
        };
        match text.split_once(':') {
            Some(("spp", count)) => samples(count).map(Self::Samples),
            Some(("oracle", count)) => samples(count).map(Self::Oracle),
            _ if text == "plain" => Ok(Self::Plain),
            _ if text == "oracle" => Ok(Self::Oracle(1)),
            _ if [".exr", ".png"].iter().any(|end| text.to_ascii_lowercase().ends_with(end)) => {
                Ok(Self::File(text.into()))
            }
            _ => Err("write a picture's .exr or .png file, plain, spp:N, oracle or oracle:N".into()),
        }
    }
}

impl std::fmt::Display for Against {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(f),
            Self::Plain => f.write_str("plain vertices"),
            Self::Samples(count) => write!(f, "{count} samples a pixel"),
            Self::Oracle(1) => f.write_str("the oracle"),
            Self::Oracle(count) => write!(f, "the oracle, {count} samples a pixel"),
        }
    }
}

/// What the frame shows, for those who render it again.
pub struct Subject<'a> {
    pub scene: &'a SceneArgs,
    pub pose: CameraPose,
    pub job: &'a FrameJob,
}

/// A picture to compare with.
pub struct Truth {
    picture: Picture,
    /// Of the frame that it is, if it is one that was rendered for the purpose.
    class: Option<String>,
}

/// What is known of the picture before the scene is read.
pub struct Wanted<'a> {
    pub scene: &'a SceneArgs,
    pub out: &'a OutputFile,
    pub report: Option<&'a OutputFile>,
    pub width: u32,
    pub height: u32,
    pub samples: u32,
    pub format: PixelFormat,
}

impl Against {
    /// Checks what can be checked before the scene is read, and reads the picture if it is in a file.
    pub fn check(&self, wanted: &Wanted<'_>) -> Result<Option<Truth>, CommandError> {
        let refuse = |what: String| Err(CommandError::Usage(format!("--error-against {self}: {what}")));
        let is_bundle = wanted.scene.scene.extension().is_some_and(|e| e.eq_ignore_ascii_case("tpack"));
        let path = match self {
            Self::Plain | Self::Oracle(_) if is_bundle => {
                let bundle = wanted.scene.scene.display();
                return refuse(format!(
                    "{bundle} is a bundle, which holds no exact scene; name what it was packed from"
                ));
            }
            Self::Samples(samples) if u64::from(*samples) < 4 * u64::from(wanted.samples) => {
                let least = 4 * u64::from(wanted.samples);
                return refuse(format!(
                    "that is no truer than the picture; ask for at least {least}, four times its samples"
                ));
            }
            Self::Plain | Self::Oracle(_) | Self::Samples(_) => return Ok(None),
            Self::File(path) => path,
        };
        if [Some(wanted.out), wanted.report].into_iter().flatten().any(|file| file.is_at(path)) {
            return refuse("this render would replace it; name another file by --out or --report".into());
        }
        let picture = Picture::load(path).map_err(CommandError::failed)?;
        let kind = kind_of(wanted.format);
        if picture.kind != Kind::Linear && picture.kind != kind {
            return refuse(format!(
                "holds {}, and the picture {}; name an EXR file, or one of the picture's kind",
                picture.kind.name(),
                kind.name()
            ));
        }
        if (picture.width, picture.height) != (wanted.width, wanted.height) {
            return refuse(format!(
                "is {} x {} pixels large, and the picture {} x {}; give it by --size",
                picture.width, picture.height, wanted.width, wanted.height
            ));
        }
        Ok(Some(Truth { picture, class: None }))
    }

    /// The picture that was not read from a file: linear, or of the kind that the frame is of.
    fn make(
        &self,
        subject: &Subject<'_>,
        session: &mut Session<'_>,
        progress: &Progress,
    ) -> Result<Truth, CommandError> {
        let job = subject.job;
        let frame = match self {
            Self::File(path) => {
                let picture = Picture::load(path).map_err(CommandError::failed)?;
                return Ok(Truth { picture, class: None });
            }
            Self::Oracle(samples) => {
                let options = subject.scene.packing.options();
                let scene =
                    tessera_scene::load(&subject.scene.scene, &options.load).map_err(CommandError::failed)?;
                let truths = Truths::new(&scene, options.without, References::open(None)?, progress)?;
                let view = View {
                    pose: subject.pose,
                    width: job.width,
                    height: job.height,
                    samples: *samples,
                    depth: job.depth,
                    min_weight: job.sampling.cutoff.into(),
                };
                return Ok(Truth { picture: truths.picture(&view, progress)?, class: None });
            }
            Self::Plain => plain_frame(subject, session, progress)?,
            // Of another seed: the picture's own samples must not be among them.
            Self::Samples(samples) => {
                let sampling = Sampling { adaptive: None, ..job.sampling };
                session.render(&FrameJob {
                    samples: *samples,
                    sampling,
                    seed: job.seed ^ 1,
                    ..job.clone()
                })?
            }
        };
        Ok(Truth {
            picture: Picture::from_frame(&frame.image),
            class: frame.numeric_class().map(String::from),
        })
    }
}

/// The frame of plain vertices by the same crew.
fn plain_frame(
    subject: &Subject<'_>,
    session: &Session<'_>,
    progress: &Progress,
) -> Result<FrameResult, CommandError> {
    let mut options = subject.scene.packing.options();
    options.plain = Plain { positions: true, normals: true, uvs: true };
    let prepared = {
        let _bar = progress.step("preparing the scene with plain vertices");
        prepare::prepare(&subject.scene.scene, &options).map_err(CommandError::failed)?
    };
    let job = subject.job;
    let camera =
        subject.pose.to_local(&prepared.pack.frame(), job.width, job.height).map_err(CommandError::usage)?;
    let mut session = Session::open(&prepared.pack, session.crew(), progress)?;
    let frame = session.render(&FrameJob { camera, ..job.clone() });
    session.close();
    frame
}

/// Renders the frame with 1, 2, 4, ... samples a pixel up to those that it is to have, each from its beginning, which takes less than three times as
/// long, and says after each how far it is. The last one is the frame that was asked for.
pub fn render(
    against: &Against,
    known: Option<Truth>,
    subject: &Subject<'_>,
    session: &mut Session<'_>,
    progress: &Progress,
) -> Result<(FrameResult, ErrorReport), CommandError> {
    let job = subject.job;
    let mut truth = match known {
        Some(truth) => truth,
        None => against.make(subject, session, progress)?,
    };
    if job.format != PixelFormat::Layers {
        truth.clamp();
    }
    let mut report = ErrorReport { against: against.to_string(), steps: Vec::new() };
    let mut total = Duration::ZERO;
    for samples in fewer(job) {
        step(&FrameJob { samples, ..job.clone() }, &truth, session, &mut total, &mut report, progress)?;
    }
    let frame = step(job, &truth, session, &mut total, &mut report, progress)?;
    Ok((frame, report))
}

/// Powers of two below the samples of `job`; none of an adaptive one, which adds samples by itself.
fn fewer(job: &FrameJob) -> impl Iterator<Item = u32> {
    let most = if job.sampling.adaptive.is_some() { 1 } else { job.samples };
    std::iter::successors(Some(1u32), |n| n.checked_mul(2)).take_while(move |n| *n < most)
}

fn step(
    job: &FrameJob,
    truth: &Truth,
    session: &mut Session<'_>,
    total: &mut Duration,
    report: &mut ErrorReport,
    progress: &Progress,
) -> Result<FrameResult, CommandError> {
    let frame = session.render(job)?;
    *total += frame.timings.frame;
    if let (Some(class), Some(own)) = (&truth.class, frame.numeric_class())
        && class != own
    {
        return Err(CommandError::Failed(format!(
            "the truer picture was rendered by {class} and this one by {own}; choose one with --backend"
        )));
    }
    let error =
        compare(&truth.picture, &seen(&frame.image, truth.picture.kind)).map_err(CommandError::failed)?;
    let step = ErrorStep::new(job.samples, frame.timings.frame, *total, error);
    if report.steps.is_empty() {
        progress.line(ErrorStep::HEAD);
    }
    progress.line(&step.text());
    report.steps.push(step);
    Ok(frame)
}

impl Truth {
    /// Light beyond what 8 or 16 bits can show is no error of the picture's.
    fn clamp(&mut self) {
        if self.picture.kind == Kind::Linear {
            let values = self.picture.channels.iter_mut().flatten();
            values.for_each(|value| *value = value.clamp(0.0, 1.0));
        }
    }
}

/// The frame as a picture of `kind`. Codes are decoded for a linear one, and premultiplied as linear pictures are: what coding has rounded
/// stays part of the error.
fn seen(image: &FrameBuffer, kind: Kind) -> Picture {
    let found = Picture::from_frame(image);
    if kind != Kind::Linear || found.kind == Kind::Linear {
        return found;
    }
    let peak = found.kind.peak();
    let alpha = image.alpha();
    let channels = found.channels.map(|codes| {
        let light = codes.iter().map(|code| linear_from_srgb(f64::from(*code) / peak));
        light.zip(&alpha).map(|(light, alpha)| (light * f64::from(*alpha)) as f32).collect()
    });
    Picture { kind, channels, ..found }
}

/// What pictures of a format are compared as.
fn kind_of(format: PixelFormat) -> Kind {
    match format {
        PixelFormat::Rgba8 => Kind::Codes8,
        PixelFormat::Rgba16 => Kind::Codes16,
        PixelFormat::Layers => Kind::Linear,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_to_compare_with_is_read() {
        let read = |text: &str| text.parse::<Against>();
        assert_eq!(read("plain"), Ok(Against::Plain));
        assert_eq!(read("spp:256"), Ok(Against::Samples(256)));
        assert_eq!(read("oracle"), Ok(Against::Oracle(1)));
        assert_eq!(read("oracle:16"), Ok(Against::Oracle(16)));
        assert_eq!(read("a/b:c.EXR"), Ok(Against::File("a/b:c.EXR".into())));
        for bad in ["", "spp", "spp:0", "spp:x", "oracle:65537", "plain:1", "picture.jpg"] {
            assert!(read(bad).is_err(), "{bad}");
        }
    }
}
