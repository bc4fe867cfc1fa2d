//! Values that flags take, checked where they are read.

use std::str::FromStr;
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
    fn fields_of_view() {
        assert_eq!(field_of_view("70"), Ok(70.0));
        for bad in ["0", "180", "-5", "nan", "wide"] {
            assert!(field_of_view(bad).is_err(), "{bad}");
        }
    }
}
