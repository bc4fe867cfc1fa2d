//! How rays are traced: one by one or eight at once.

use fearless_simd::Level;

/// How packets of rays are traced. Every kernel gives the same answers, bit for bit; they differ in speed alone.
#[derive(Clone, Copy, Debug)]
pub enum Kernel {
    /// Ray by ray.
    Scalar,
    /// Eight rays at once, with these instructions.
    Wide(Level),
}

impl PartialEq for Kernel {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Eq for Kernel {}

impl Default for Kernel {
    /// [`Kernel::auto`].
    fn default() -> Self {
        Self::auto()
    }
}

impl Kernel {
    /// Eight rays at once with the best instructions that this machine has; ray by ray when it has none for several numbers.
    pub fn auto() -> Self {
        let level = Level::new();
        if level.is_fallback() { Self::Scalar } else { Self::Wide(level) }
    }

    /// Eight rays at once, if need be as plain arrays.
    pub fn wide() -> Self {
        Self::Wide(Level::new())
    }

    /// For people and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            Self::Wide(level) if level.as_avx2().is_some() => "8-wide AVX2",
            #[cfg(target_arch = "x86_64")]
            Self::Wide(_) => "8-wide SSE2",
            #[cfg(not(target_arch = "x86_64"))]
            Self::Wide(_) => "8-wide",
        }
    }

    /// The instructions for eight lanes, `None` for single rays.
    pub(crate) fn level(self) -> Option<Level> {
        match self {
            Self::Scalar => None,
            Self::Wide(level) => Some(level),
        }
    }
}

/// Evaluates `$op` with the token `$simd` of the best instructions of `$level`. Two versions are compiled, for AVX2 and for what
/// every machine of the target has: more would take long to compile and gain nothing on eight lanes.
macro_rules! dispatch {
    ($level:expr, $simd:ident => $op:expr) => {{
        #[cfg(target_arch = "x86_64")]
        {
            if let Some($simd) = $level.as_avx2() {
                $simd.vectorize(
                    #[inline(always)]
                    || $op,
                )
            } else {
                let $simd = $crate::kernel::baseline();
                $op
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            fearless_simd::dispatch!($level, $simd => $op)
        }
    }};
}
pub(crate) use dispatch;

/// The instructions that every x86-64 machine has.
#[cfg(target_arch = "x86_64")]
pub(crate) fn baseline() -> fearless_simd::x86::Sse2 {
    match Level::baseline().as_sse2() {
        Some(token) => token,
        None => unreachable!("SSE2 is part of x86-64"),
    }
}
