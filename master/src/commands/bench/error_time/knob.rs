//! What is varied, and the settings that are tried.

use std::fmt;
use tessera_kdtree::BuildOptions;
use tessera_master::PrepareOptions;
use tessera_pack::{NormalCode, Plain};
use tessera_scene::Without;
use tessera_wire::{Adaptive, Features, Sampler, Sampling};
use tessera_worker::Kernel;

/// A dial between error and run time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Knob {
    /// Samples a pixel, with each sampler
    Spp,
    /// Samples where they are needed, against the same everywhere
    Adaptive,
    /// What is quantised: nothing, positions, normals too, texture coordinates too; with and without mirrors and glass
    Packed,
    /// Levels of positions: the finest grid, and bits within its cells
    Positions,
    /// Codes of vertex normals
    Normals,
    /// Bits of texture coordinates
    Uv,
    /// Triangle references on inner nodes, and when they are made
    Refs,
    /// Mirrors and glass that a path may meet
    Depth,
    /// The weight below which rays are not traced
    Cutoff,
    /// What renders
    Backend,
    /// Sides of tiles
    Tile,
}

impl Knob {
    /// Its name on the command line, in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Spp => "spp",
            Self::Adaptive => "adaptive",
            Self::Packed => "packed",
            Self::Positions => "positions",
            Self::Normals => "normals",
            Self::Uv => "uv",
            Self::Refs => "refs",
            Self::Depth => "depth",
            Self::Cutoff => "cutoff",
            Self::Backend => "backend",
            Self::Tile => "tile",
        }
    }

    /// A heading.
    pub fn title(self) -> &'static str {
        match self {
            Self::Spp => "Samples a pixel",
            Self::Adaptive => "Adaptive sampling",
            Self::Packed => "What is quantised",
            Self::Positions => "Levels of positions",
            Self::Normals => "Codes of normals",
            Self::Uv => "Bits of texture coordinates",
            Self::Refs => "Triangle references",
            Self::Depth => "Depth of recursion",
            Self::Cutoff => "Weight cut-off",
            Self::Backend => "What renders",
            Self::Tile => "Sides of tiles",
        }
    }

    /// What is varied, what is held, and what the error is measured against.
    pub fn what(self) -> &'static str {
        match self {
            Self::Spp => {
                "Samples a pixel are doubled, with each sampler. Vertices are plain and the oracle takes many more samples, so that the \
                 error is the sampler's."
            }
            Self::Adaptive => {
                "Samples are added to blocks of 16 x 16 pixels, at least 16 and at most four times --spp-max a pixel, until the error that \
                 their scatter lets expect is below a threshold; beside it the same sampler with as many samples everywhere. Vertices are \
                 plain. The threshold is one of sRGB-coded values, as a viewer sees them; the front is by linear light."
            }
            Self::Packed => {
                "The rows of the paper's Table 4: plain vertices, quantised positions (POS), normals too (POS/NORM), texture coordinates \
                 too (POS/NORM/TEX), each with and without reflection and refraction. The error is that against the oracle; the last \
                 columns compare with the frame of plain vertices, as the paper does."
            }
            Self::Positions => {
                "The finest grid that positions may have, intervals of the scene's longest side, and then fewer bits within a cell of the \
                 default grid. Normals and texture coordinates are plain."
            }
            Self::Normals => {
                "The code of vertex normals: 16 bits by Smith, Petrova, Schaefer 2012, 16 bits octahedral, or f32. Positions and texture \
                 coordinates are plain."
            }
            Self::Uv => "Bits of a texture coordinate, or f32. Positions and normals are plain.",
            Self::Refs => {
                "References on an inner node of the kd-tree, and the thresholds that make them. Pictures are equal: only bytes and time \
                 move."
            }
            Self::Depth => {
                "Mirrors and bent rays that a path may meet one after the other; the truth may meet 32. The cut-off is the same."
            }
            Self::Cutoff => {
                "The weight in the pixel below which a mirror or glass ray is not traced; the truth's is 2^-20. The depth is the same."
            }
            Self::Backend => {
                "Who traces the rays of the same pack. Pictures of one numeric class are equal. A GPU takes part only where --gpu names \
                 one."
            }
            Self::Tile => {
                "The side of a tile, on a worker in this process behind the protocol that workers elsewhere speak. Pictures are equal: \
                 only time moves."
            }
        }
    }

    /// The settings, in the order of their tables.
    pub fn settings(self, base: &Base) -> Vec<Setting> {
        match self {
            Self::Spp => spp(base),
            Self::Adaptive => adaptive(base),
            Self::Packed => packed(base),
            Self::Positions => positions(base),
            Self::Normals => normals(base),
            Self::Uv => uv(base),
            Self::Refs => refs(base),
            Self::Depth => depth(base),
            Self::Cutoff => cutoff(base),
            Self::Backend => backend(base),
            Self::Tile => tile(base),
        }
    }
}

impl fmt::Display for Knob {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What is held while one knob is turned.
#[derive(Clone, Debug)]
pub struct Base {
    /// As `tessera render` packs.
    pub packing: PrepareOptions,
    /// One sample a pixel.
    pub look: Look,
    /// Most samples a pixel.
    pub spp_max: u32,
    /// Samples a pixel of the truth of samplers.
    pub truth_spp: u32,
    /// Whether a GPU takes part.
    pub has_gpu: bool,
}

/// What a frame is asked for besides its view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Samples a pixel, the most of them where `adaptive` is set.
    pub samples: u32,
    /// How they are taken.
    pub sampling: Sampling,
    /// Mirrors and bent rays of a path.
    pub depth: u32,
    /// What is switched on.
    pub features: Features,
}

/// Who renders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum By {
    /// All cores.
    Cpu(Kernel),
    /// The GPU that was asked for.
    Gpu,
    /// A worker in this process that is sent tiles of this side.
    Tiles(u32),
}

/// What the oracle is asked for: the rest is the frame's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Samples a pixel.
    pub samples: u32,
    /// Mirrors and bent rays of a path.
    pub depth: u32,
    /// Weight below which rays are not traced.
    pub min_weight: f64,
}

/// One point of a curve.
#[derive(Clone, Debug)]
pub struct Setting {
    /// The curve.
    pub series: String,
    /// Where on it.
    pub value: String,
    /// The same as a number, where it is one.
    pub number: Option<f64>,
    /// How the scene is packed.
    pub packing: PrepareOptions,
    /// What the frame is asked for.
    pub look: Look,
    /// Who renders it.
    pub by: By,
    /// What it is compared with.
    pub truth: Truth,
}

/// Greatest depth that a truth needs: the protocol's.
const DEEPEST: u32 = tessera_wire::limits::DEPTH;

/// 2^-20: a truth with hardly a cut-off. A ray below it changes a pixel by at most 2^-20 of the radiance that it would bring, a sixteenth of
/// what the smallest setting tried leaves out.
const FAINTEST: f64 = 1.0 / 1_048_576.0;

impl Base {
    /// The frame as it is rendered by default, compared with the truth that has its depth and cut-off.
    fn setting(&self, series: impl Into<String>, value: impl Into<String>) -> Setting {
        let truth =
            Truth { samples: 1, depth: self.look.depth, min_weight: self.look.sampling.cutoff.into() };
        Setting {
            series: series.into(),
            value: value.into(),
            number: None,
            packing: self.packing.clone(),
            look: self.look,
            by: By::Cpu(Kernel::auto()),
            truth,
        }
    }

    /// The same with a number.
    fn numbered(&self, series: impl Into<String>, number: impl Into<f64>) -> Setting {
        let number = number.into();
        Setting { number: Some(number), ..self.setting(series, number.to_string()) }
    }

    /// Plain vertices with so many samples a pixel, compared with many more.
    fn sampled(
        &self,
        series: &str,
        value: String,
        samples: u32,
        sampler: Sampler,
        adaptive: Option<Adaptive>,
    ) -> Setting {
        let mut setting = Setting { packing: plain(self), ..self.setting(series, value) };
        setting.number = adaptive.is_none().then(|| samples.into());
        setting.look.samples = samples;
        setting.look.sampling = Sampling { sampler, adaptive, ..setting.look.sampling };
        setting.truth.samples = self.truth_spp;
        setting
    }

    /// Most samples a pixel of adaptive sampling.
    fn spp_most(&self) -> u32 {
        4 * self.spp_max
    }

    /// Powers of two times `least`, up to `most`.
    fn doublings(&self, least: u32, most: u32) -> impl Iterator<Item = u32> + use<> {
        std::iter::successors(Some(least), |n| n.checked_mul(2)).take_while(move |n| *n <= most)
    }
}

pub const ALL_PLAIN: Plain = Plain { positions: true, normals: true, uvs: true };

fn spp(base: &Base) -> Vec<Setting> {
    let of = |sampler: Sampler| {
        base.doublings(1, base.spp_max)
            .map(move |samples| base.sampled(sampler.name(), samples.to_string(), samples, sampler, None))
    };
    Sampler::ALL.into_iter().flat_map(of).collect()
}

fn adaptive(base: &Base) -> Vec<Setting> {
    let (sampler, most) = (Sampler::LowDiscrepancy, base.spp_most());
    let uniform = base
        .doublings(16.min(most), most)
        .map(|samples| base.sampled("uniform", samples.to_string(), samples, sampler, None));
    let adaptive = (3..=8).map(|power| {
        let adaptive = Adaptive { error: f64::from(1u32 << power).recip() as f32 };
        base.sampled("adaptive", format!("2^-{power}"), most, sampler, Some(adaptive))
    });
    uniform.chain(adaptive).collect()
}

/// What of the vertices is quantised in the rows of Table 4, and the row's name.
const TABLE_4: [(&str, Plain); 4] = [
    ("plain", ALL_PLAIN),
    ("POS", Plain { positions: false, ..ALL_PLAIN }),
    ("POS/NORM", Plain { positions: false, normals: false, uvs: true }),
    ("POS/NORM/TEX", Plain { positions: false, normals: false, uvs: false }),
];

fn packed(base: &Base) -> Vec<Setting> {
    let all = base.look.features;
    let none = Features { reflection: false, refraction: false, ..all };
    let of = |(series, features): (&'static str, Features)| {
        TABLE_4.into_iter().map(move |(name, plain)| {
            let mut setting = base.setting(series, name);
            setting.packing.plain = plain;
            setting.packing.without = Without {
                reflection: !features.reflection,
                refraction: !features.refraction,
                ..setting.packing.without
            };
            setting.look.features = features;
            setting
        })
    };
    [("all rays", all), ("no reflection, no refraction", none)].into_iter().flat_map(of).collect()
}

fn positions(base: &Base) -> Vec<Setting> {
    let setting = |series: &str, number: u32, change: &dyn Fn(&mut PrepareOptions)| {
        let mut setting = base.numbered(series, number);
        setting.packing.plain = Plain { positions: false, ..ALL_PLAIN };
        change(&mut setting.packing);
        setting
    };
    let grids = (5..=13).map(|power| 1 << power).map(|n| setting("grid", n, &|p| p.max_intervals = n));
    let bits = (1..=9).map(|bits| setting("bits in a cell", bits, &|p| p.position_bits = bits));
    let mut all: Vec<_> = grids.chain(bits).collect();
    all.push(Setting { packing: plain(base), ..base.setting("plain", "f32") });
    all
}

fn normals(base: &Base) -> Vec<Setting> {
    let code = |code: NormalCode, value: &str| {
        let mut setting = base.setting("16 bits", value);
        setting.packing.plain = Plain { normals: false, ..ALL_PLAIN };
        setting.packing.normal_code = code;
        setting
    };
    let plain = Setting { packing: plain(base), ..base.setting("plain", "f32") };
    vec![code(NormalCode::Smith, "Smith"), code(NormalCode::Oct, "octahedral"), plain]
}

fn uv(base: &Base) -> Vec<Setting> {
    let bits = |bits: u32| {
        let mut setting = base.numbered("fixed point", bits);
        setting.packing.plain = Plain { uvs: false, ..ALL_PLAIN };
        setting.packing.uv_bits = bits;
        setting
    };
    let mut all: Vec<_> = [5, 6, 7, 8, 9, 10, 11, 12, 14, 16].map(bits).into();
    all.push(Setting { packing: plain(base), ..base.setting("plain", "f32") });
    all
}

fn plain(base: &Base) -> PrepareOptions {
    PrepareOptions { plain: ALL_PLAIN, ..base.packing.clone() }
}

fn refs(base: &Base) -> Vec<Setting> {
    let tree = |series: &str, value: String, tree: BuildOptions| {
        let mut setting = base.setting(series, value);
        setting.packing.tree = tree;
        setting
    };
    let usual = base.packing.tree;
    let counts =
        (0..=2).map(|max_refs| tree("references", max_refs.to_string(), BuildOptions { max_refs, ..usual }));
    let tests = [0.0, 0.3, 1.0, 2.0].map(|tau_tests| {
        tree("two, by tau_tests", format!("{tau_tests}"), BuildOptions { tau_tests, ..usual })
    });
    let saving = [0.0, 0.25, 4.0, 16.0].map(|least_saving| {
        tree("two, by least_saving", format!("{least_saving}"), BuildOptions { least_saving, ..usual })
    });
    counts.chain(tests).chain(saving).collect()
}

fn depth(base: &Base) -> Vec<Setting> {
    let depths = [0, 1, 2, 3, 4, 6, 8, 12, 16, 32];
    let of = |depth: u32| {
        let mut setting = base.numbered("depth", depth);
        (setting.look.depth, setting.truth.depth) = (depth, DEEPEST);
        setting
    };
    depths.map(of).into()
}

fn cutoff(base: &Base) -> Vec<Setting> {
    let of = |power: u32| {
        let weight = f64::from(1u32 << power).recip();
        let mut setting = base.setting("weight", format!("2^-{power}"));
        setting.number = Some(weight);
        (setting.look.sampling.cutoff, setting.truth.min_weight) = (weight as f32, FAINTEST);
        setting
    };
    (1..=16).map(of).collect()
}

fn backend(base: &Base) -> Vec<Setting> {
    let mut kernels = vec![Kernel::Scalar, Kernel::auto()];
    kernels.dedup();
    let cpu = kernels
        .into_iter()
        .map(|kernel| Setting { by: By::Cpu(kernel), ..base.setting("CPU", kernel.name()) });
    let gpu = base.has_gpu.then(|| Setting { by: By::Gpu, ..base.setting("GPU", "GPU") });
    cpu.chain(gpu).collect()
}

fn tile(base: &Base) -> Vec<Setting> {
    [8, 16, 32, 64, 128, 256, 512]
        .map(|side| Setting { by: By::Tiles(side), ..base.numbered("tile", side) })
        .into()
}
