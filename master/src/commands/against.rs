//! `--error-against`: how far a picture is from a truer one, beside the time that it took.

use super::progress::Progress;
use super::reference::{References, Truths};
use super::run::Session;
use super::{CommandError, SceneArgs};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;
use tessera_geometry::{CameraPose, linear_from_srgb};
use tessera_master::compare::{Kind, Picture, compare};
use tessera_master::report::{ErrorReport, ErrorStep};
use tessera_master::{FrameBuffer, FrameJob, FrameResult, PixelFormat, prepare};
use tessera_oracle::View;
use tessera_pack::Plain;
use tessera_wire::limits;

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

impl Against {
    /// Checks what can be checked before the scene is read.
    pub fn check(&self, scene: &SceneArgs, out: &Path) -> Result<(), CommandError> {
        let is_bundle = scene.scene.extension().is_some_and(|e| e.eq_ignore_ascii_case("tpack"));
        match self {
            Self::Plain | Self::Oracle(_) if is_bundle => Err(CommandError::Usage(format!(
                "--error-against {self}: {} is a bundle, which holds no exact scene; name the scene that it was packed from",
                scene.scene.display()
            ))),
            Self::File(path) if path == out => Err(CommandError::Usage(format!(
                "--error-against {self}: the picture would replace it; name another file by --out"
            ))),
            _ => Ok(()),
        }
    }

    /// The picture to compare with: linear, or of the kind that the frame is of.
    pub fn picture(
        &self,
        subject: &Subject<'_>,
        session: &mut Session<'_>,
        progress: &Progress,
    ) -> Result<Picture, CommandError> {
        let job = subject.job;
        let found = match self {
            Self::File(path) => Picture::load(path).map_err(CommandError::failed)?,
            Self::Plain => plain_frame(subject, session, progress)?,
            Self::Samples(samples) => {
                let sampling = tessera_wire::Sampling { adaptive: None, ..job.sampling };
                let frame = session.render(&FrameJob { samples: *samples, sampling, ..job.clone() })?;
                Picture::from_frame(&frame.image)
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
                truths.picture(&view, progress)?
            }
        };
        if found.kind != Kind::Linear && found.kind != kind_of(job.format) {
            return Err(CommandError::Usage(format!(
                "--error-against {self}: holds {}, and the picture {}; name an EXR file, or one of the picture's kind",
                found.kind.name(),
                kind_of(job.format).name()
            )));
        }
        if (found.width, found.height) != (job.width, job.height) {
            return Err(CommandError::Usage(format!(
                "--error-against {self}: is {} x {} pixels large, and the picture {} x {}; give it by --size",
                found.width, found.height, job.width, job.height
            )));
        }
        Ok(found)
    }
}

/// The frame of plain vertices by the same crew.
fn plain_frame(
    subject: &Subject<'_>,
    session: &Session<'_>,
    progress: &Progress,
) -> Result<Picture, CommandError> {
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
    Ok(Picture::from_frame(&frame?.image))
}

/// Renders the frame with 1, 2, 4, ... samples a pixel up to those that it is to have, which takes less than twice as long, and says after
/// each how far it is. The last one is the frame that was asked for.
pub fn render(
    against: &Against,
    subject: &Subject<'_>,
    session: &mut Session<'_>,
    progress: &Progress,
) -> Result<(FrameResult, ErrorReport), CommandError> {
    let job = subject.job;
    let truth = against.picture(subject, session, progress)?;
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
    truth: &Picture,
    session: &mut Session<'_>,
    total: &mut Duration,
    report: &mut ErrorReport,
    progress: &Progress,
) -> Result<FrameResult, CommandError> {
    let frame = session.render(job)?;
    *total += frame.timings.frame;
    let error = compare(truth, &seen(&frame.image, truth.kind)).map_err(CommandError::failed)?;
    let step = ErrorStep::new(job.samples, frame.timings.frame, *total, error);
    if report.steps.is_empty() {
        progress.line(ErrorStep::HEAD);
    }
    progress.line(&step.text());
    report.steps.push(step);
    Ok(frame)
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
