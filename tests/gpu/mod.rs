//! A GPU against the CPU: the same triangles, but where rounding decides, and the same picture.
//!
//! `TESSERA_GPU=require` fails without an adapter, `off` skips aloud, `allow` (the default) skips where there is none, aloud too. `pretend` has the CPU play
//! the GPU, with the camera turned by a digit and with hits in single precision: it tests these tests where there is no GPU.
//!
//! ```text
//! TESSERA_GPU=require cargo test --release --test tests -- gpu:: --nocapture
//! ```

mod device;
mod fleet;
mod hard;
mod judge;
mod pretend;
mod rays;
mod scenes;

use judge::{Finding, TBound, judge};
use rayon::prelude::*;
use std::fmt;
use std::sync::{Mutex, Once, OnceLock};
use tessera_geometry::{Hit, Ray};
use tessera_pack::{NO_TEXTURE, Pack};
use tessera_whitted::{FrameParams, PixelBlock, PixelFormat, Probe, Renderer};

/// A renderer that is held to the CPU.
trait Other: Sync {
    /// For people.
    fn name(&self) -> String;

    /// How far its distances may be off.
    fn t_bound(&self) -> TBound;

    /// Whether a worker can render on it.
    fn is_device(&self) -> bool {
        false
    }

    /// Whether its rays from the eye, and all that is made of them, are the CPU's bit for bit: then no difference is left to chance.
    fn is_exact(&self) -> bool {
        false
    }

    /// Triangles that it renders in bearable time.
    fn triangles_max(&self) -> u32;

    /// The whole frame, in `params.format`.
    fn frame(&self, pack: &Pack, params: &FrameParams) -> Vec<u8>;

    /// [`Probe::signature`] of every pixel's first sample, row by row.
    fn signatures(&self, pack: &Pack, params: &FrameParams) -> Vec<u32>;

    /// The rays of the first sample of each of `pixels`, as [`Renderer::probe`] orders them.
    fn probes(&self, pack: &Pack, params: &FrameParams, pixels: &[(u32, u32)]) -> Vec<Vec<Probe>>;

    /// The nearest hit of each ray, every triangle counting.
    fn hits(&self, pack: &Pack, rays: &[Ray]) -> Vec<Option<Hit>>;
}

/// The GPU with `f64` as far as it has it, and without; or why there is none.
fn open() -> Result<[&'static device::Device; 2], String> {
    // (A driver is opened once; it is not given back between tests.)
    static DEVICES: OnceLock<Result<[device::Device; 2], String>> = OnceLock::new();
    let devices = DEVICES.get_or_init(|| Ok([device::Device::open(true)?, device::Device::open(false)?]));
    devices.as_ref().map(|devices| devices.each_ref()).map_err(Clone::clone)
}

/// [`with_every`], but for the GPU without `f64`.
fn with_other(test: impl Fn(&dyn Other)) {
    with(1, test);
}

/// What is tested, if anything. One test at a time: drivers are not all as safe between threads as they say, and memory is one.
fn with_every(test: impl Fn(&dyn Other)) {
    with(2, test);
}

fn with(precisions: usize, test: impl Fn(&dyn Other)) {
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    // A test that failed has said so itself.
    let _one = ONE_AT_A_TIME.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    let asked = std::env::var("TESSERA_GPU").unwrap_or_else(|_| "allow".into());
    match (asked.as_str(), open()) {
        ("pretend", _) => {
            test(&pretend::Cpu::nudged(f32::EPSILON));
            test(&pretend::Single);
        }
        ("require" | "allow", Ok(devices)) => {
            devices.iter().take(precisions).for_each(|device| test(*device))
        }
        ("require", Err(why)) => panic!("TESSERA_GPU=require, and there is {why}"),
        ("allow", Err(why)) => skip(&why),
        ("off", _) => skip("TESSERA_GPU=off"),
        _ => panic!("TESSERA_GPU is `require`, `allow`, `off` or `pretend`"),
    }
}

/// Says once that nothing is tested, past the test harness, which keeps what a test that passes prints.
fn skip(why: &str) {
    use std::io::Write;
    static SAID: Once = Once::new();
    SAID.call_once(|| {
        // Nothing is lost with a stderr that nobody reads.
        let _ = writeln!(std::io::stderr(), "GPU tests skipped: {why}");
    });
}

/// A frame of both.
struct Report {
    name: String,
    pixels: usize,
    /// Whether mirrors or glass are about, which make one difference many.
    has_optics: bool,
    /// [`Other::is_exact`].
    is_exact: bool,
    /// Pixels whose paths took other triangles, each with its reason.
    findings: Vec<Finding>,
    /// Of the 8-bit pictures, in decibels; `None`: equal. Without the pixels above, and whole.
    psnr: [Option<f64>; 2],
    /// Pixels that took the same triangles and whose layers say otherwise.
    torn: usize,
    /// Of all channels of all linear pixels that took the same triangles: largest and mean difference.
    linear: [f64; 2],
}

impl Report {
    /// PSNR that the pixels with the same triangles must have.
    const PSNR_MIN: f64 = 60.0;

    /// Share of pixels whose paths may take other triangles as far as one mirror or bent ray. Behind more, paths of one digit's difference part for good in a share that
    /// the scene makes, a few thousandths among balls of glass; of these it counts only that each is explained.
    fn share_max(&self) -> f64 {
        if self.has_optics { 1e-3 } else { 1e-4 }
    }

    /// What is wrong with it, if any share of pixels may differ by rounding.
    fn hard_faults(&self) -> Vec<String> {
        let mut faults = Vec::new();
        let unexplained = self.findings.iter().filter(|finding| !finding.why.is_explained()).count();
        if unexplained > 0 {
            faults.push(format!("{unexplained} differences are unexplained"));
        }
        if let Some(psnr) = self.psnr[0].filter(|psnr| *psnr < Self::PSNR_MIN) {
            faults.push(format!("{psnr:.1} dB where both took the same triangles"));
        }
        if self.torn > 0 {
            faults.push(format!("{} pixels show another triangle than their path took", self.torn));
        }
        faults
    }

    /// What is wrong with it.
    fn faults(&self) -> Vec<String> {
        let mut faults = self.hard_faults();
        let differing = self.findings.iter().filter(|finding| self.is_exact || !finding.is_deep).count();
        let (share, most) = (differing as f64 / self.pixels as f64, self.share_max());
        if share > most {
            faults.push(format!("a share of {share:.1e} took other triangles, more than {most:.0e}"));
        }
        faults
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [others, whole] =
            self.psnr.map(|psnr| psnr.map_or("equal".to_owned(), |psnr| format!("{psnr:.1} dB")));
        let [largest, mean] = self.linear;
        writeln!(
            f,
            "{}: {} of {} pixels took other triangles, {} of them behind two or more mirrors or bent rays alone; the others {others}, linear {largest:.1e} at most, {mean:.1e} in the mean; whole frame {whole}",
            self.name,
            self.findings.len(),
            self.pixels,
            self.findings.iter().filter(|finding| finding.is_deep).count()
        )?;
        /// Lines of a table that is read.
        const LINES: usize = 40;
        let is_fault = |finding: &&Finding| !finding.why.is_explained();
        let faults = self.findings.iter().filter(is_fault);
        let lines: Vec<_> =
            faults.chain(self.findings.iter().filter(|f| f.why.is_explained())).take(LINES).collect();
        if !lines.is_empty() {
            writeln!(f, "{}", Finding::HEAD)?;
        }
        lines.into_iter().try_for_each(|line| writeln!(f, "{line}"))
    }
}

/// Holds a frame of `other` to the CPU's.
fn check(name: &str, pack: &Pack, params: &FrameParams, other: &dyn Other) {
    let report = compare(name, pack, params, other);
    println!("{report}");
    let faults = report.faults();
    assert!(faults.is_empty(), "{}: {}\n{report}", other.name(), faults.join("; "));
}

/// [`check`] of a scene in which rounding decides a share of pixels that nobody foresees.
fn check_hard(name: &str, pack: &Pack, params: &FrameParams, other: &dyn Other) {
    let report = compare(name, pack, params, other);
    println!("{report}");
    let faults = report.hard_faults();
    assert!(faults.is_empty(), "{}: {}\n{report}", other.name(), faults.join("; "));
}

/// Renders with both and looks into every pixel that took other triangles.
fn compare(name: &str, pack: &Pack, params: &FrameParams, other: &dyn Other) -> Report {
    let renderer = Renderer::new(pack);
    let pixels: Vec<_> = (0..params.height).flat_map(|y| (0..params.width).map(move |x| (x, y))).collect();

    // Find them, and have the other write their rays down.
    let own: Vec<u32> =
        pixels.par_iter().map(|&(x, y)| Probe::signature(&renderer.probe(params, x, y, 0))).collect();
    let others = other.signatures(pack, params);
    assert_eq!(own.len(), others.len(), "{name}: a signature a pixel");
    let differs: Vec<bool> = own.iter().zip(&others).map(|(a, b)| a != b).collect();
    let differing: Vec<_> = pixels.iter().zip(&differs).filter(|(_, d)| **d).map(|(p, _)| *p).collect();

    // Judge them; enough of them, where everything differs.
    const JUDGED: usize = 2000;
    let judged: Vec<_> = differing.iter().copied().step_by(differing.len().div_ceil(JUDGED).max(1)).collect();
    let probes = other.probes(pack, params, &judged);
    let mut findings: Vec<_> = judged
        .par_iter()
        .zip(&probes)
        .map(|(&(x, y), rays)| {
            assert_eq!(
                Probe::signature(rays),
                others[(y * params.width + x) as usize],
                "{name}: the rays that were written down are not those that were rendered, pixel {x}, {y}"
            );
            let own = renderer.probe(params, x, y, 0);
            judge((&renderer, pack), params, ((x, y), 0), (&own, rays), other.t_bound())
                .expect("the signatures differ")
        })
        .collect();
    findings.extend(std::iter::repeat_n(findings.last().cloned(), differing.len() - judged.len()).flatten());

    // Look into some that took the same triangles too: their rays must be near, step by step.
    const LOOKED_INTO: usize = 500;
    let same: Vec<_> = pixels.iter().zip(&differs).filter(|(_, d)| !**d).map(|(p, _)| *p).collect();
    let same: Vec<_> = same.iter().copied().step_by(same.len().div_ceil(LOOKED_INTO).max(1)).collect();
    let probes = other.probes(pack, params, &same);
    findings.par_extend(same.par_iter().zip(&probes).filter_map(|(&(x, y), rays)| {
        let own = renderer.probe(params, x, y, 0);
        judge((&renderer, pack), params, ((x, y), 0), (&own, rays), other.t_bound())
            .filter(|finding| !finding.why.is_explained())
    }));

    // Compare the pictures.
    let picture = |format: PixelFormat| {
        let params = FrameParams { format, ..*params };
        let (own, others) = (pretend::frame(pack, &params), other.frame(pack, &params));
        assert_eq!(own.len(), others.len(), "{name}: bytes of a frame");
        (own, others)
    };
    let (own, others) = picture(PixelFormat::Rgba8);
    let psnr = [&differs[..], &vec![false; pixels.len()]].map(|left_out| psnr(&own, &others, left_out));
    let (own, others) = picture(PixelFormat::Layers);
    let layers = |bytes: &[u8]| -> Vec<[u32; 9]> {
        let word = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().expect("four bytes"));
        let pixel = |bytes: &[u8]| std::array::from_fn(|i| word(&bytes[4 * i..4 * i + 4]));
        bytes.chunks_exact(36).map(pixel).collect()
    };
    let (mut torn, mut linear, mut count) = (0, [0.0f64; 2], 0);
    for ((own, others), _) in layers(&own).iter().zip(&layers(&others)).zip(&differs).filter(|(_, d)| !**d) {
        // With many samples the surface shown is that behind the centre, of which nothing was written down.
        torn += usize::from(own[8] != others[8] && params.samples <= 1);
        for (a, b) in own[..4].iter().zip(&others[..4]) {
            let difference = (f64::from(f32::from_bits(*a)) - f64::from(f32::from_bits(*b))).abs();
            linear = [linear[0].max(difference), linear[1] + difference];
            count += 1;
        }
    }
    linear[1] /= f64::from(count.max(1));
    let (name, pixels, has_optics) = (name.to_owned(), pixels.len(), has_optics(pack));
    let is_exact = other.is_exact();
    Report { name, pixels, has_optics, is_exact, findings, psnr, torn, linear }
}

/// Whether a material may send a mirror or bent ray.
fn has_optics(pack: &Pack) -> bool {
    pack.materials()
        .iter()
        .any(|m| m.transmission > 0.0 || m.roughness < 0.5 || m.metallic_roughness_texture != NO_TEXTURE)
}

/// Peak signal to noise of 8-bit red, green and blue over the pixels that are not left out; `None` when these are equal.
fn psnr(a: &[u8], b: &[u8], left_out: &[bool]) -> Option<f64> {
    let pixels = a.chunks_exact(4).zip(b.chunks_exact(4)).zip(left_out).filter(|(_, out)| !**out);
    let (mut sum, mut count) = (0u64, 0u64);
    for ((a, b), _) in pixels {
        for (a, b) in a[..3].iter().zip(&b[..3]) {
            sum += u64::from(a.abs_diff(*b)).pow(2);
            count += 1;
        }
    }
    (sum > 0).then(|| 10.0 * libm::log10(255.0 * 255.0 * count as f64 / sum as f64))
}

/// The whole frame as a block.
fn whole(params: &FrameParams) -> PixelBlock {
    PixelBlock { x: 0, y: 0, width: params.width, height: params.height }
}
