//! Values that flags take, checked where they are read.

use std::str::FromStr;
use std::time::Duration;
use tessera_pack::NormalCode;
use tessera_wire::limits;

/// An image size, `WIDTHxHEIGHT`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Columns, 1..=[`limits::SIDE`].
    pub width: u32,
    /// Rows, 1..=[`limits::SIDE`].
    pub height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |side: &str| side.parse().ok().filter(|side| (1..=limits::SIDE).contains(side));
        text.split_once(['x', 'X'])
            .and_then(|(w, h)| Some(Self { width: side(w)?, height: side(h)? }))
            .ok_or_else(|| {
                format!("write WIDTHxHEIGHT with sides of 1 to {} pixels, as in 1024x768", limits::SIDE)
            })
    }
}

/// Three finite numbers, `x,y,z`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triple(pub [f64; 3]);

impl FromStr for Triple {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut parts = text.split(',').map(|part| part.trim().parse().ok().filter(|v: &f64| v.is_finite()));
        let triple = (|| Some([parts.next()??, parts.next()??, parts.next()??]))();
        match (triple, parts.next()) {
            (Some(triple), None) => Ok(Self(triple)),
            _ => Err("write three finite numbers, as in -120,20,0".into()),
        }
    }
}

/// A vertical field of view in degrees, inside (0, 180).
pub fn field_of_view(text: &str) -> Result<f64, String> {
    let degrees: Option<f64> = text.parse().ok();
    degrees
        .filter(|d| *d > 0.0 && *d < 180.0)
        .ok_or_else(|| "write the vertical field of view in degrees, more than 0 and less than 180".into())
}

/// A weight, [0, 1].
pub fn weight(text: &str) -> Result<f32, String> {
    let weight: Option<f32> = text.parse().ok();
    weight.filter(|w| (0.0..=1.0).contains(w)).ok_or_else(|| "write a weight of 0 to 1, as in 0.002".into())
}

/// An error of sRGB-coded values, (0, 1].
pub fn coded_error(text: &str) -> Result<f32, String> {
    let error: Option<f32> = text.parse().ok();
    error
        .filter(|e| *e > 0.0 && *e <= 1.0)
        .ok_or_else(|| "write an error of more than 0 and at most 1, as in 0.004 (a step of 8 bits)".into())
}

/// A time of 1 s to 366 days: a number with s, m, h or d.
pub fn time(text: &str) -> Result<Duration, String> {
    const SECONDS_MAX: u64 = 366 * 24 * 3600;
    let units = [('s', 1), ('m', 60), ('h', 3600), ('d', 24 * 3600)];
    let seconds = units.into_iter().find_map(|(unit, seconds)| {
        let number: u64 = text.strip_suffix(unit)?.parse().ok()?;
        number.checked_mul(seconds)
    });
    match seconds {
        Some(seconds @ 1..=SECONDS_MAX) => Ok(Duration::from_secs(seconds)),
        _ => Err("write a time of 1s to 366d, as in 30m or 8h".into()),
    }
}

/// A number of bytes, with B, KiB, MiB, GiB or TiB.
pub fn byte_size(text: &str) -> Result<u64, String> {
    let units = [("KiB", 10), ("MiB", 20), ("GiB", 30), ("TiB", 40), ("B", 0)];
    let bytes = units.into_iter().find_map(|(unit, shift)| {
        let number: u64 = text.strip_suffix(unit)?.trim_end().parse().ok()?;
        number.checked_mul(1 << shift)
    });
    bytes.ok_or_else(|| "write a number of bytes with B, KiB, MiB, GiB or TiB, as in 8GiB".into())
}

/// A number that is finite and not below 0.
pub fn at_least_zero(text: &str) -> Result<f32, String> {
    let number: Option<f32> = text.trim().parse().ok();
    number
        .filter(|v| *v >= 0.0 && v.is_finite())
        .ok_or_else(|| "write a number of 0 or more, as in 0.5".into())
}

/// When a triangle is worth a reference on an inner node of the kd-tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefsWhen {
    /// Share of the node's extent, in [0, 1].
    pub occupancy: f32,
    /// Share of the non-empty leaves below the node, in [0, 1].
    pub frequency: f32,
    /// Tests by a ray through the node, not below 0; none: as usual.
    pub tests: Option<f32>,
}

impl FromStr for RefsWhen {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut parts = text.split(',').map(|part| at_least_zero(part).ok());
        let mut share = || parts.next().flatten().filter(|share| *share <= 1.0);
        let shares = share().zip(share());
        match (shares, parts.next(), parts.next()) {
            (Some((occupancy, frequency)), None, _) => Ok(Self { occupancy, frequency, tests: None }),
            (Some((occupancy, frequency)), Some(Some(tests)), None) => {
                Ok(Self { occupancy, frequency, tests: Some(tests) })
            }
            _ => {
                Err("write two shares of 0 to 1, and a number of tests if you like, as in 0.5,0.4,0.6".into())
            }
        }
    }
}

/// Codes of shading normals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Normals {
    /// Spread evenly over the sphere, at most 0.563 degrees off; a table of 768 KiB to decode with.
    Smith,
    /// On an octahedron, at most 0.638 degrees off; no table.
    Oct,
}

impl From<Normals> for NormalCode {
    fn from(normals: Normals) -> Self {
        match normals {
            Normals::Smith => Self::Smith,
            Normals::Oct => Self::Oct,
        }
    }
}

/// Vertex data that `--plain` may hold as `f32`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PlainPart {
    /// Positions.
    Positions,
    /// Shading normals.
    Normals,
    /// Texture coordinates.
    Uv,
}

/// Features that `--without` may leave out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Feature {
    /// All images, and texture coordinates with them.
    Textures,
    /// Shadow rays.
    Shadows,
    /// Mirror reflection.
    Reflection,
    /// Refraction: glass becomes opaque.
    Refraction,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!("1024x768".parse(), Ok(Size { width: 1024, height: 768 }));
        assert_eq!("1X1".parse(), Ok(Size { width: 1, height: 1 }));
        for bad in ["", "1024", "0x5", "5x0", "65537x1", "-1x4", "1x2x3", "axb", "99999999999x1"] {
            assert!(bad.parse::<Size>().is_err(), "{bad}");
        }
    }

    #[test]
    fn triples() {
        assert_eq!("-120, 20,0.5".parse(), Ok(Triple([-120.0, 20.0, 0.5])));
        for bad in ["", "1,2", "1,2,3,4", "1,2,nan", "1,inf,2", "a,b,c"] {
            assert!(bad.parse::<Triple>().is_err(), "{bad}");
        }
    }

    #[test]
    fn what_is_worth_a_reference() {
        let when = |occupancy, frequency, tests| Ok(RefsWhen { occupancy, frequency, tests });
        assert_eq!("0.5,0.4".parse(), when(0.5, 0.4, None));
        assert_eq!("0, 1, 2.5".parse(), when(0.0, 1.0, Some(2.5)));
        let bad =
            ["", "0.5", "0.5,", "0.5,1.1", "-0.1,0.4", "0.5,0.4,-1", "0.5,0.4,inf", "0.5,nan", "1,1,1,1"];
        for bad in bad.into_iter().chain(["0.5,0.4,", "0.5,0.4,x"]) {
            assert!(bad.parse::<RefsWhen>().is_err(), "{bad}");
        }
        assert_eq!((at_least_zero("0"), at_least_zero("1e3")), (Ok(0.0), Ok(1000.0)));
        assert!(["-1", "nan", "1e99", ""].into_iter().all(|bad| at_least_zero(bad).is_err()));
    }

    #[test]
    fn byte_sizes() {
        for (text, bytes) in [("0B", 0), ("1KiB", 1024), ("8GiB", 8 << 30), ("3 TiB", 3 << 40)] {
            assert_eq!(byte_size(text), Ok(bytes), "{text}");
        }
        for bad in ["", "8", "GiB", "-1B", "1.5GiB", "8GB", "99999999999TiB"] {
            assert!(byte_size(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn weights_and_errors() {
        assert_eq!([weight("0"), weight("1"), weight("0.001953125")], [Ok(0.0), Ok(1.0), Ok(1.0 / 512.0)]);
        assert_eq!([coded_error("1"), coded_error("4e-3")], [Ok(1.0), Ok(4e-3)]);
        for bad in ["", "-0.1", "1.1", "nan", "inf", "x", "1/512"] {
            assert!(weight(bad).is_err() && coded_error(bad).is_err(), "{bad}");
        }
        assert!(coded_error("0").is_err() && coded_error("1e-50").is_err(), "no error is as small as 0");
    }

    #[test]
    fn fields_of_view() {
        assert_eq!(field_of_view("70"), Ok(70.0));
        for bad in ["0", "180", "-5", "nan", "wide"] {
            assert!(field_of_view(bad).is_err(), "{bad}");
        }
    }
}
