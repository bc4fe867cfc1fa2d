//! Bugs to be planted on purpose, one at a time: what `tessera check` must notice.
//!
//! Only a build with the feature `mutations` has them. The root package's dev-dependencies switch it on: so its tests have it, and the program
//! that Cargo builds along with them, whose times are not those of a release. `cargo build` and `cargo install` switch it off. Without it [`is_on`] is
//! the constant `false`, and nothing of a mutation is left in the program. `tests/MUTATIONS.md` lists them with the cases that notice.

#[cfg(feature = "mutations")]
use std::sync::atomic::{AtomicU8, Ordering};

/// Whether this build can plant bugs.
pub const ARE_THERE: bool = cfg!(feature = "mutations");

/// Defines the mutations from their names and what each does.
macro_rules! mutations {
    ($($variant:ident $name:literal $what:literal)*) => {
        /// A bug in one place.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Mutation {
            $(#[doc = $what] $variant,)*
        }

        impl Mutation {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$variant),*];

            /// As it is asked for.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            /// What is wrong with it, in a line.
            pub const fn what(self) -> &'static str {
                match self { $(Self::$variant => $what),* }
            }
        }
    };
}

mutations! {
    EdgesExclusive "edges-exclusive" "an edge function of 0 counts as outside"
    NoExactEdges "no-exact-edges" "an edge function of 0 is not decided in f64"
    WideNoExactEdges "wide-no-exact-edges" "the same, in the test of eight rays alone"
    RangeExclusive "range-exclusive" "`<` for `<=` at the far end of a ray's range, where ties are decided"
    LargestId "largest-id" "of equally near triangles the largest id wins"
    SwappedChildren "swapped-children" "the far child of an inner node is visited before the near one"
    OneSideOfPlane "one-side-of-plane" "a ray in a split plane visits one side of it"
    ThinRay "thin-ray" "rays have no thickness"
    StopEarly "stop-early" "the margin of the stop rule is added instead of taken off, a thousandfold"
    ReferenceSkipped "reference-skipped" "the second reference of an inner node is not tested"
    AnyIgnoresEnd "any-ignores-end" "any hit counts, also beyond the end of the ray"
    CutGoesLow "cut-goes-low" "a triangle that a plane cuts is listed on the low side alone"
    DecodeCorner "decode-corner" "a vertex is decoded to its voxel's corner instead of its centre"
    NormalNext "normal-next" "a normal is given the code after its own"
    UvTruncated "uv-truncated" "texture coordinates are truncated instead of rounded"
    MirrorShift "mirror-shift" "a mirrored texture is shifted by odd numbers too"
    WrapClamped "wrap-clamped" "a repeating texture is blended with itself at its border"
    PointErrorTimes10 "point-error-x10" "the bound of a hit point's error is ten times too large"
    PointErrorTimes1000 "point-error-x1000" "the bound of a hit point's error is a thousand times too large"
    PointErrorTenth "point-error-tenth" "the bound of a hit point's error is a tenth of what it must be"
    OffsetWrongSide "offset-wrong-side" "rays leave a surface from its other side"
    NoClearance "no-clearance" "hits of a ray from a surface begin at once"
    NoLightMargin "no-light-margin" "occluders of a light end at the light itself"
    IorInverted "ior-inverted" "the ratio of refractive indices is upside down"
    NoTotalReflection "no-total-reflection" "what is totally reflected passes straight"
    FresnelOneSided "fresnel-one-sided" "the reflectance of glass is that of one polarisation"
    DepthOffByOne "depth-off-by-one" "paths go one surface too deep"
    ShadowsIgnoreAlpha "shadows-ignore-alpha" "shadow rays stop at what blends"
    Unstratified "unstratified" "samples are independent of each other"
    SobolFlat "sobol-flat" "the second dimension of Sobol's sequence is the first again"
    CodesTruncated "codes-truncated" "colour codes are truncated instead of rounded"
    GpuEdgesExclusive "gpu-edges-exclusive" "edges-exclusive, in the GPU's text"
    GpuSwappedChildren "gpu-swapped-children" "swapped-children, in the GPU's text"
    GpuNoClearance "gpu-no-clearance" "no-clearance, in the GPU's text"
    GpuIorInverted "gpu-ior-inverted" "ior-inverted, in the GPU's text"
}

/// The one that is on, plus 1; 0 for none.
#[cfg(feature = "mutations")]
static ON: AtomicU8 = AtomicU8::new(0);

/// Whether `mutation` is on.
#[cfg(feature = "mutations")]
#[inline]
pub fn is_on(mutation: Mutation) -> bool {
    ON.load(Ordering::Relaxed) == mutation as u8 + 1
}

/// Whether `mutation` is on: never, in this build.
#[cfg(not(feature = "mutations"))]
#[inline(always)]
pub const fn is_on(_: Mutation) -> bool {
    false
}

/// Switches `mutation` on, before anything is packed or traced.
#[cfg(feature = "mutations")]
pub fn switch_on(mutation: Mutation) {
    ON.store(mutation as u8 + 1, Ordering::Relaxed);
}

/// Does nothing: this build has none.
#[cfg(not(feature = "mutations"))]
pub fn switch_on(_: Mutation) {}

/// `right`, or `wrong` where `mutation` is on.
#[inline(always)]
pub fn unless<T>(mutation: Mutation, right: T, wrong: T) -> T {
    if is_on(mutation) { wrong } else { right }
}
