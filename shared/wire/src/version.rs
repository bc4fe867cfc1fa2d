//! The protocol's history.

/// A version of the protocol. Every change of a message, a limit or a meaning adds a variant with its line.
///
/// The beginning of `Hello` and the reason `Refuse(Version)` are frozen: peers of any two versions can read them, so that disjoint
/// peers part with a reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u16)]
pub enum Version {
    /// Handshake, one pack by hash, frames of tiles in four balancings, batches of raw pixels.
    V1 = 1,
    /// `Hello` has a token and a role; certificates are pinned by fingerprint; reasons and close codes for joining. Not mixed with 1,
    /// whose peers knew each other by an authority that lived in one process.
    V2 = 2,
    /// `Abilities` has a speed and a note on the device, `PackRefusal` a reason for what a GPU cannot hold; frames may mix numeric
    /// classes: `Render` says so, `Restarted` and the summaries tell of classes and how far they differ.
    V3 = 3,
    /// `Frame` says how its samples are taken: by which sampler, to which weight, and whether adaptively.
    V4 = 4,
    /// Several frames at a time; `Cancel` and `Cancelled`; pixels may be packed (`Frame::coding`, `TileEntry`), and each tile says where its
    /// time went; five balancings more.
    V5 = 5,
}

impl Version {
    /// All versions that this build speaks, newest first.
    pub const SUPPORTED: &'static [Self] = &[Self::V5];

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
        assert_eq!(Version::common(&[5]), Some(Version::V5));
        assert_eq!(Version::common(&[7, 6, 5, 1]), Some(Version::V5), "a newer one that still speaks ours");
        assert_eq!(Version::common(&[4, 3, 2, 1]), None, "an older one");
        assert_eq!(Version::common(&[6, 7]), None, "a newer one");
        assert_eq!(Version::common(&[]), None);
        assert_eq!(Version::from_number(5), Some(Version::V5));
        assert_eq!([0, 1, 2, 3, 4, 6].map(Version::from_number), [None; 6]);
    }
}
