//! `tessera render` of a camera that moves: many frames, each a file.

mod pattern;
mod poses;
mod write;

use super::render::{FrameArgs, Plan};
use super::run::{Asked, Session, Source};
use super::{CommandError, progress::Progress};
use clap::Args;
use pattern::Pattern;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use tessera_geometry::CameraPose;
use tessera_master::prepare::{Prepared, choose_camera};
use tessera_master::{FrameJob, SequenceConfig, Stale};
use tokio::sync::mpsc;

/// Frames of a camera that moves.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Sequence")]
pub struct SequenceArgs {
    /// Render N frames of the camera's animation in a glTF scene, or of --path; --out is then a pattern, as in frame-%04d.png
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(poses::FRAMES_MAX)))]
    frames: Option<u32>,
    /// Frames a second of the animation's or the path's time [default: --frames spread from the first key to the last]
    #[arg(long, value_name = "F", value_parser = frames_a_second, allow_hyphen_values = true)]
    fps: Option<f64>,
    /// Render along a path: a file of poses with eye and target, in JSON an object a line, or in TOML a table named pose each
    ///
    /// up, fov (degrees) and time (seconds) may be given too. Without --frames and --fps each pose is a frame; else frames lie on straight
    /// lines between the poses, which without times are a second apart.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["poses", "eye"])]
    path: Option<PathBuf>,
    /// Render poses as they come on stdin, one a line in JSON as in --path
    #[arg(long, value_name = "-", value_parser = ["-"], conflicts_with_all = ["frames", "fps", "eye"])]
    poses: Option<String>,
    /// Skip poses that have not begun when a newer one is there
    #[arg(long, requires = "poses", conflicts_with_all = ["path", "frames", "fps"])]
    newest: bool,
    /// Give up frames under way too; after that one is seen to its end, so that pictures come however fast poses do
    #[arg(long, requires = "newest", conflicts_with_all = ["path", "frames", "fps"])]
    give_up: bool,
    /// Split the workers into G groups, which render frames by turns: with as many groups as workers each renders whole frames [default: 1]
    #[arg(long, value_name = "G", value_parser = clap::value_parser!(u32).range(1..=256))]
    groups: Option<u32>,
    /// Frames of each group under way at a time; with 2 workers go on to the next frame while the last tiles of one return [default: 2]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=6))]
    ahead: Option<u32>,
}

/// A rate of frames.
fn frames_a_second(text: &str) -> Result<f64, String> {
    let fps: Option<f64> = text.parse().ok();
    fps.filter(|fps| *fps > 0.0 && *fps <= 1e6)
        .ok_or_else(|| "write a number of frames a second, more than 0, as in 30".into())
}

impl SequenceArgs {
    /// Whether many frames are asked for.
    pub fn is_asked_for(&self) -> bool {
        self.frames.is_some() || self.fps.is_some() || self.path.is_some() || self.poses.is_some()
    }

    /// Refuses what would change nothing.
    pub fn check(&self, is_elsewhere: bool) -> Result<(), String> {
        let given = [("--groups", self.groups.is_some()), ("--ahead", self.ahead.is_some())];
        let flag = given.iter().find(|(_, is_given)| *is_given).map(|(flag, _)| *flag);
        match flag {
            Some(flag) if !self.is_asked_for() => {
                Err(format!("{flag} is for many frames; name them by --frames, --fps, --path or --poses"))
            }
            Some(flag) if is_elsewhere => Err(format!(
                "{flag}: a master elsewhere renders the frames of a client one after the other; leave it out, or render with --workers"
            )),
            _ if self.give_up && is_elsewhere => Err(
                "--give-up: a frame that a master elsewhere has begun is seen to its end; leave it out, --newest skips those that wait".into(),
            ),
            _ => Ok(()),
        }
    }

    /// The name of the first file, where `out` is a pattern.
    pub fn first_file(&self, out: &Path) -> Result<PathBuf, CommandError> {
        Ok(Pattern::parse(out)?.file(0))
    }

    fn config(&self) -> SequenceConfig {
        let stale = match (self.newest, self.give_up) {
            (_, true) => Stale::GiveUp,
            (true, false) => Stale::Skip,
            (false, false) => Stale::Render,
        };
        let SequenceConfig { groups, depth, .. } = SequenceConfig::default();
        SequenceConfig { groups: self.groups.unwrap_or(groups), depth: self.ahead.unwrap_or(depth), stale }
    }
}

/// Renders the sequence to files that are named after `out`.
pub fn render(
    args: &SequenceArgs,
    out: &Path,
    plan: &Plan<'_>,
    frame: &FrameArgs,
    prepared: &Prepared,
    progress: &Progress,
) -> Result<(), CommandError> {
    let pattern = Pattern::parse(out)?;
    let job_of = jobs(plan, prepared)?;
    let source = match (&args.path, &args.poses) {
        (None, Some(_)) => {
            let fov = default_fov(frame, prepared)?;
            Source::Stream(listen(fov, job_of)?)
        }
        (Some(path), _) => {
            let keys = poses::read_file(path, default_fov(frame, prepared)?).map_err(CommandError::Usage)?;
            let poses = poses::along(&keys, args.frames, args.fps);
            let poses = poses.map_err(|what| CommandError::Usage(format!("{}: {what}", path.display())))?;
            Source::List(all(&poses, &job_of)?.into_iter())
        }
        (None, None) => Source::List(all(&animated(args, frame, prepared)?, &job_of)?.into_iter()),
    };
    let mut session = Session::open(&prepared.pack, plan.crew(), progress)?;
    let writer = write::Writer::start(pattern, frame.json);
    let rendered = session.sequence(source, args.config(), writer.images());
    session.close();
    // A file that cannot be written is why nothing more was rendered.
    let written = writer.finish()?;
    written.print(&rendered?)
}

/// Makes a pose a job.
fn jobs(
    plan: &Plan<'_>,
    prepared: &Prepared,
) -> Result<impl Fn(&CameraPose) -> Result<FrameJob, String> + Send + 'static, CommandError> {
    let frame = prepared.pack.frame();
    // Any view will do for what is not the view.
    let first = &choose_camera(&prepared.cameras, None).map_err(CommandError::Usage)?.pose;
    let job = plan.job(first, prepared)?;
    Ok(move |pose: &CameraPose| {
        let camera = pose.to_local(&frame, job.width, job.height);
        let camera = camera.map_err(|e| format!("the camera cannot be used: {e}"))?;
        Ok(FrameJob { camera, ..job.clone() })
    })
}

fn all(
    poses: &[CameraPose],
    job_of: &impl Fn(&CameraPose) -> Result<FrameJob, String>,
) -> Result<Vec<FrameJob>, CommandError> {
    let job = |(number, pose): (usize, &CameraPose)| {
        job_of(pose).map_err(|what| CommandError::Usage(format!("frame {number}: {what}")))
    };
    poses.iter().enumerate().map(job).collect()
}

/// The field of view of poses that state none: that of the camera that a still would have.
fn default_fov(frame: &FrameArgs, prepared: &Prepared) -> Result<f64, CommandError> {
    Ok(frame.pose(prepared)?.1.fov_degrees)
}

/// The poses of the camera's animation.
fn animated(
    args: &SequenceArgs,
    frame: &FrameArgs,
    prepared: &Prepared,
) -> Result<Vec<CameraPose>, CommandError> {
    let (name, _) = frame.pose(prepared)?;
    let Some(name) = name else {
        let what = "--frames and --fps play a camera's animation; leave --eye out, or give poses with --path";
        return Err(CommandError::Usage(what.into()));
    };
    let Some(track) = prepared.camera_tracks.iter().find(|track| track.camera == name) else {
        let moving = prepared.camera_tracks.iter().map(|track| track.camera.as_str());
        let known = match prepared.camera_tracks.len() {
            0 => "the scene has no animation of a camera".to_owned(),
            _ => format!("those that have are {}", tessera_scene::import::listed(moving)),
        };
        return Err(CommandError::Usage(format!(
            "the camera `{name}` has no animation to take frames of; {known}; name one with --camera, or give poses with --path"
        )));
    };
    let times = poses::times((0.0, track.duration()), args.frames, args.fps).map_err(CommandError::Usage)?;
    let pose = |seconds: f64| {
        track.pose_at(seconds).ok_or_else(|| {
            CommandError::Usage(format!("the animation `{}` leaves no view at {seconds} s", track.animation))
        })
    };
    times.into_iter().map(pose).collect()
}

/// Reads poses from stdin in a thread of its own, which ends with the process if it is still waiting then.
fn listen(
    fov: f64,
    job_of: impl Fn(&CameraPose) -> Result<FrameJob, String> + Send + 'static,
) -> Result<mpsc::Receiver<Asked>, CommandError> {
    /// Poses that wait; where all are wanted, who writes them waits too.
    const WAITING: usize = 16;
    let (tell, asked) = mpsc::channel(WAITING);
    let read = move || {
        let take = |key: poses::Key| job_of(&key.pose).map(|job| tell.blocking_send(Ok(job)).is_ok());
        if let Err(what) = poses::read_lines(BufReader::new(std::io::stdin()), fov, take) {
            let _ = tell.blocking_send(Err(CommandError::Failed(format!("--poses -: {what}"))));
        }
    };
    let thread = std::thread::Builder::new().name("poses".into()).spawn(read);
    thread.map_err(|e| CommandError::Failed(format!("cannot start the thread that reads poses: {e}")))?;
    Ok(asked)
}
