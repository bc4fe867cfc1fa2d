//! The protocol's history.

/// A version of the protocol. Every change of a message, a limit or a meaning adds a variant with its line.
///
/// The layouts of `Hello` and `Refuse` are frozen: peers of any two versions can read them, so that disjoint
/// peers part with a reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u16)]
pub enum Version {
    /// Handshake, one pack by hash, frames of tiles in four balancings, batches of raw pixels.
    V1 = 1,
}

impl Version {
    /// All versions that this build speaks, newest first.
    pub const SUPPORTED: &'static [Self] = &[Self::V1];

    /// The number on the wire.
    pub const fn number(self) -> u16 {
        self as u16
    }

    /// The version with this number, if this build speaks it.
    pub fn from_number(number: u16) -> Option<Self> {
        Self::SUPPORTED.iter().copied().find(|v| v.number() == number)
    }

    /// The numbers of [`Version::SUPPORTED`], as `Hello` carries them.
    pub fn supported_numbers() -> Vec<u16> {
        Self::SUPPORTED.iter().map(|v| v.number()).collect()
    }

    /// The newest version that both this build and a peer with `theirs` speak.
    pub fn common(theirs: &[u16]) -> Option<Self> {
        Self::SUPPORTED.iter().copied().find(|v| theirs.contains(&v.number()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_older_a_newer_and_a_disjoint_peer() {
        assert_eq!(Version::common(&[1]), Some(Version::V1));
        assert_eq!(Version::common(&[7, 3, 1]), Some(Version::V1));
        assert_eq!(Version::common(&[2, 3]), None);
        assert_eq!(Version::common(&[]), None);
        assert_eq!(Version::from_number(1), Some(Version::V1));
        assert_eq!(Version::from_number(0), None);
    }
}
