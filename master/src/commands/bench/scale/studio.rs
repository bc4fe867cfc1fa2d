//! Measuring clusters of one frame's devices.

use super::args::{ClusterArgs, DeviceKind};
use super::case::{Case, Measured, Row, median, ms};
use super::link::LinkProfile;
use super::real::{Device, RealCluster};
use super::recorded::Recorded;
use super::sim::Costs;
use super::simulated::Simulated;
use crate::commands::args::{PlainPart, Size};
use crate::commands::bench::folder::Folder;
use crate::commands::progress::Progress;
use crate::commands::run::prepare_scene;
use crate::commands::{CommandError, PackingArgs};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::time::Duration;
use tessera_geometry::LocalCamera;
use tessera_master::prepare::{Prepared, choose_camera};
use tessera_master::trace::TraceFile;
use tessera_master::{Balance, FrameJob};
use tessera_wire::Coding;

/// A row of the paper's Table 7.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Compression {
    /// What is compressed.
    pub what: String,
    pub one_ms: f64,
    pub sixteen_ms: f64,
}

/// A frame that was recorded, for clusters to render.
pub struct Studio<'a> {
    args: &'a ClusterArgs,
    prepared: Prepared,
    job: FrameJob,
    pub recorded: Recorded,
    /// What a second of the recording takes a device of speed 1.
    scale: f64,
    /// Holds the recording's file until the end.
    _folder: tempfile::TempDir,
    file: PathBuf,
    pub scene: String,
    pub camera: String,
}

/// How a case hands out tiles of which side; none leaves the side to the balancing, or is 128.
pub type Way = (Balance, Option<u32>);

impl<'a> Studio<'a> {
    /// Prepares the scene, and records the frame.
    pub fn open(args: &'a ClusterArgs, progress: &Progress) -> Result<Self, CommandError> {
        let prepared = prepare_scene(&args.scene, &PackingArgs::default(), progress)?;
        let (camera, job) = job(args, &prepared)?;
        let recorded = {
            let _bar = progress.step("recording the frame");
            Recorded::render(&prepared.pack, &job, progress)?
        };
        let scale = match args.device {
            DeviceKind::Real => 1.0,
            DeviceKind::Replay | DeviceKind::Simulated => args.one_worker / recorded.total().as_secs_f64(),
        };
        let folder = tempfile::tempdir().map_err(CommandError::failed)?;
        let file = folder.path().join("recording");
        recorded.write(&file)?;
        let scene = super::super::name_of(&args.scene);
        Ok(Self { args, prepared, job, recorded, scale, _folder: folder, file, scene, camera })
    }

    /// What the frame takes one device of speed 1, without launches.
    pub fn one_worker(&self) -> Duration {
        self.recorded.total().mul_f64(self.scale)
    }

    /// Measures workers of these speeds in all `ways`; traces of the last frames go to a folder, if there is one.
    pub fn measure_cluster(
        &self,
        link: &LinkProfile,
        speeds: &[f64],
        ways: &[Way],
        traces: Option<&Folder>,
        progress: &Progress,
        rows: &mut Vec<Row>,
    ) -> Result<(), CommandError> {
        let device = match self.args.device {
            DeviceKind::Real => Some(Device::Real(&self.prepared.pack)),
            DeviceKind::Replay => Some(Device::Replay {
                recording: &self.file,
                scale: self.scale,
                launch_us: self.args.launch_us,
            }),
            DeviceKind::Simulated => None,
        };
        let cluster =
            device.map(|device| RealCluster::start(link, speeds, device, progress.log())).transpose();
        let mut cluster = cluster?;
        let (runs, frames) = match (self.args.quick, speeds.len()) {
            (false, _) => (self.args.runs, self.args.frames),
            (true, 1) => (1, 1),
            (true, _) => (1, 2),
        };
        let plans = ways.iter().map(|&(balance, side)| {
            let case = Case { link: link.clone(), balance, speeds: speeds.to_vec() };
            let tile = side.unwrap_or(if balance == Balance::Auto { 0 } else { FrameJob::TILE });
            let job = FrameJob { tile, coding: self.coding(balance), ..self.job.clone() };
            let warm = warm_up(balance, speeds.len());
            // The same in each run.
            let simulated = self.simulator().run(&case, &job, warm + frames as usize, &[])?;
            Ok::<_, CommandError>((case, job, warm, simulated))
        });
        let plans: Vec<_> = plans.collect::<Result<_, _>>()?;
        for run in 0..runs {
            for (case, job, warm, simulated) in &plans {
                let measured = match &mut cluster {
                    Some(cluster) => cluster.run(case, job, simulated.len())?,
                    None => simulated.clone(),
                };
                if let Some(wrong) = measured.iter().find(|frame| frame.hash != self.recorded.hash) {
                    return Err(CommandError::Failed(format!(
                        "{} on {}: the image is {}, not {}",
                        case.balance, link.name, wrong.hash, self.recorded.hash
                    )));
                }
                let took: Vec<_> = simulated[*warm..].iter().map(|frame| ms(frame.took)).collect();
                let predicted = median(&took).filter(|_| cluster.is_some());
                for (number, frame) in (0..).zip(&measured[*warm..]) {
                    rows.push(self.row(case, run, number, frame, predicted));
                }
                if let (Some(folder), Some(last)) = (traces.filter(|_| run + 1 == runs), measured.last()) {
                    self.write_trace(folder, case, job, last)?;
                }
            }
        }
        if let Some(cluster) = cluster {
            cluster.stop();
        }
        Ok(())
    }

    fn write_trace(
        &self,
        folder: &Folder,
        case: &Case,
        job: &FrameJob,
        frame: &Measured,
    ) -> Result<(), CommandError> {
        let run = frame.trace(case, &self.scene, [job.width, job.height]);
        run.check().map_err(CommandError::Failed)?;
        let name = format!("trace-{}-{}-{}.json", case.link.name, case.balance, case.speeds.len());
        folder.write(&name, &serde_json::to_vec(&TraceFile::new(&run)).map_err(CommandError::failed)?)
    }

    /// The frame of packs of which nothing, the mesh, the tree or both are compressed, as the paper's Table 7 has it: milliseconds of one device,
    /// on the scale on which that with both takes what it does here, and of sixteen, simulated as the paper's phones.
    pub fn compression(&self, progress: &Progress) -> Result<Vec<Compression>, CommandError> {
        let link = LinkProfile::find("phone").map_err(CommandError::Failed)?;
        let plain = [PlainPart::Positions, PlainPart::Normals, PlainPart::Uv];
        let variants = [("nothing", true, 0), ("mesh", false, 0), ("tree", true, 2), ("both", false, 2)];
        let render = |(what, is_plain, refs)| {
            let _bar = progress.step(format!("recording with {what} compressed"));
            let plain = if is_plain { plain.to_vec() } else { Vec::new() };
            let packing = PackingArgs { plain, refs: Some(refs), ..PackingArgs::default() };
            let prepared = prepare_scene(&self.args.scene, &packing, progress)?;
            let (_, job) = job(self.args, &prepared)?;
            Ok((what, Recorded::render(&prepared.pack, &job, progress)?))
        };
        let recorded = variants.into_iter().map(render).collect::<Result<Vec<_>, CommandError>>()?;
        let both = recorded.last().map_or(1.0, |(_, both)| both.total().as_secs_f64());
        let scale = self.args.one_worker / both;
        let time = |(what, recorded): &(&'static str, Recorded)| {
            let simulated =
                Simulated { recorded, scale, launch: Duration::ZERO, costs: Costs::default(), first_row: 0 };
            let case = Case { link: link.clone(), balance: Balance::PaperStatic, speeds: vec![1.0; 16] };
            let job = FrameJob { coding: Some(Coding::Raw), ..self.job.clone() };
            let frames = simulated.run(&case, &job, 1, &[])?;
            let sixteen_ms = frames.first().map_or(f64::NAN, |frame| ms(frame.took));
            Ok(Compression { what: (*what).into(), one_ms: ms(recorded.total().mul_f64(scale)), sixteen_ms })
        };
        recorded.iter().map(time).collect()
    }

    /// How pixels travel: as is asked for, or as usual.
    fn coding(&self, balance: Balance) -> Option<Coding> {
        match self.args.coding {
            Some(coding) => coding.0,
            None => usual_coding(balance),
        }
    }

    fn simulator(&self) -> Simulated<'_> {
        let launch = Duration::from_micros(self.args.launch_us.into());
        Simulated {
            recorded: &self.recorded,
            scale: self.scale,
            launch,
            costs: Costs::default(),
            first_row: 0,
        }
    }

    fn row(&self, case: &Case, run: u32, frame: u32, measured: &Measured, predicted_ms: Option<f64>) -> Row {
        let launches = Duration::from_micros(self.args.launch_us.into()) * measured.tiles;
        let work = self.one_worker() + launches;
        Row {
            scene: self.scene.clone(),
            link: case.link.name.clone(),
            balance: case.balance.name().into(),
            workers: case.speeds.len(),
            device: self.args.device.name().into(),
            run,
            frame,
            frame_ms: ms(measured.took),
            ideal_ms: ms(case.ideal(work, measured.bytes)),
            bytes: measured.bytes,
            tile: measured.tile,
            busy_share: measured.busy_share(case.speeds.len()),
            after_ms: measured.after_ms(),
            messages: measured.master.messages,
            master_ms: ms(measured.master.busy),
            master_cpu_ms: ms(measured.master_cpu),
            tiles: measured.tiles,
            dropped: measured.dropped,
            predicted_ms,
            why: measured.why.clone(),
        }
    }
}

/// How pixels travel unless something else is asked for: the paper's ways send them raw, as the paper did; none leaves it to the cluster.
pub fn usual_coding(balance: Balance) -> Option<Coding> {
    matches!(balance, Balance::PaperStatic | Balance::PaperDynamic).then_some(Coding::Raw)
}

/// Frames before the measured ones, in which a balancing learns. Those that learn nothing have one, in which caches are cold.
fn warm_up(balance: Balance, workers: usize) -> usize {
    match balance {
        Balance::Auto if workers > 1 => 6,
        Balance::Weighted | Balance::Staggered | Balance::Steal if workers > 1 => 2,
        _ => usize::from(workers > 1),
    }
}

/// The view of the frame that is measured.
fn job(args: &ClusterArgs, prepared: &Prepared) -> Result<(String, FrameJob), CommandError> {
    let chosen = choose_camera(&prepared.cameras, args.camera.as_deref()).map_err(CommandError::Usage)?;
    let Size { width, height } = args.size;
    let camera: LocalCamera = chosen
        .pose
        .to_local(&prepared.pack.frame(), width, height)
        .map_err(|e| CommandError::Usage(format!("the camera cannot be used: {e}")))?;
    let job = FrameJob::new(camera, width, height);
    Ok((chosen.name.clone(), job))
}
