//! What a link is like: a profile, built in or from a TOML file.

use serde::{Deserialize, Serialize};
use std::path::Path;

/// A link between workers and their master, as far as the emulation knows one. [`Medium`](super::medium::Medium) gives the numbers their
/// meaning.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkProfile {
    /// What reports call it.
    pub name: String,
    /// Where the figures come from.
    pub source: String,
    /// Megabits a second from the workers to the master, of all of them together; none: no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mbit_up: Option<f64>,
    /// The same from the master.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mbit_down: Option<f64>,
    /// Whether both directions share the medium.
    pub duplex: Duplex,
    /// Of one way.
    pub latency_ms: f64,
    /// What is added to it at random, up to this.
    #[serde(default)]
    pub jitter_ms: f64,
    /// Share of the packets that are lost, in each direction.
    #[serde(default)]
    pub loss: f64,
    /// What each packet costs of the medium's time, whatever its length.
    #[serde(default)]
    pub packet_us: f64,
    /// What the first packet of a peer and direction costs of it after a silence: a radio that wakes up and contends, a master that turns to
    /// another peer.
    #[serde(default)]
    pub burst_ms: f64,
    /// How long that silence is at least.
    #[serde(default)]
    pub burst_gap_ms: f64,
    /// Kibibytes that wait for the medium in each direction; what finds it full is dropped.
    pub queue_kib: u32,
    /// Bytes of UDP payload that a packet has at most; larger ones are dropped, so that QUIC finds the size out.
    pub mtu: u32,
    /// Of what is random.
    #[serde(default)]
    pub seed: u64,
}

/// Whether both directions of a link share its medium.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Duplex {
    /// A cable: each direction is its own.
    Full,
    /// A radio channel: one sends at a time.
    Half,
}

/// Built-in profiles, from the fastest to the slowest.
const BUILT_IN: [&str; 6] = [
    include_str!("../links/loopback.toml"),
    include_str!("../links/wired.toml"),
    include_str!("../links/lan100.toml"),
    include_str!("../links/wifi-ac.toml"),
    include_str!("../links/phone.toml"),
    include_str!("../links/wan.toml"),
];

impl LinkProfile {
    /// The built-in profiles.
    pub fn built_in() -> Result<Vec<Self>, String> {
        BUILT_IN.into_iter().map(|text| Self::parse(text, "a built-in link")).collect()
    }

    /// The built-in profile of that name, else the one in the file of that name.
    pub fn find(text: &str) -> Result<Self, String> {
        let built_in = Self::built_in()?;
        if let Some(profile) = built_in.iter().find(|profile| profile.name == text) {
            return Ok(profile.clone());
        }
        let names: Vec<_> = built_in.iter().map(|profile| profile.name.as_str()).collect();
        let file = std::fs::read_to_string(Path::new(text)).map_err(|e| {
            format!("`{text}` is no link ({}), and cannot be read as a file of one: {e}", names.join(", "))
        })?;
        Self::parse(&file, text)
    }

    /// The profile in `text`, which comes from `origin`.
    pub fn parse(text: &str, origin: &str) -> Result<Self, String> {
        let profile: Self = toml::from_str(text).map_err(|e| {
            let line =
                e.span().map_or(1, |span| text[..span.start.min(text.len())].matches('\n').count() + 1);
            format!("{origin}, line {line}: {}", e.message())
        })?;
        profile.check().map_err(|reason| format!("{origin}: {reason}"))?;
        Ok(profile)
    }

    /// The same as text, for a process that emulates it.
    pub fn to_toml(&self) -> Result<String, String> {
        toml::to_string(self).map_err(|e| e.to_string())
    }

    /// Whether it changes nothing, so that packets need no relay.
    pub fn is_straight(&self) -> bool {
        let costs = [self.latency_ms, self.jitter_ms, self.loss, self.packet_us, self.burst_ms];
        self.mbit_up.or(self.mbit_down).is_none() && costs.iter().all(|cost| *cost == 0.0)
    }

    /// Checks every number against its range.
    fn check(&self) -> Result<(), String> {
        for (key, text) in [("name", &self.name), ("source", &self.source)] {
            if text.is_empty() || text.len() > 1024 || text.chars().any(char::is_control) {
                return Err(format!("{key}: write one line of 1 to 1024 bytes"));
            }
        }
        // It is part of files' names.
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if self.name.len() > 64 || self.name.starts_with('.') || !self.name.chars().all(is_plain) {
            return Err("name: write letters, digits, `-`, `_` and `.`, 64 at most".into());
        }
        let rate = 0.01..=100_000.0;
        let ranges = [
            ("mbit_up", self.mbit_up.unwrap_or(1.0), rate.clone()),
            ("mbit_down", self.mbit_down.unwrap_or(1.0), rate),
            ("latency_ms", self.latency_ms, 0.0..=10_000.0),
            ("jitter_ms", self.jitter_ms, 0.0..=1000.0),
            ("loss", self.loss, 0.0..=0.5),
            ("packet_us", self.packet_us, 0.0..=10_000.0),
            ("burst_ms", self.burst_ms, 0.0..=1000.0),
            ("burst_gap_ms", self.burst_gap_ms, 0.0..=10_000.0),
            ("queue_kib", self.queue_kib.into(), 8.0..=65_536.0),
            // QUIC sends 1,200 bytes at least.
            ("mtu", self.mtu.into(), 1200.0..=65_507.0),
        ];
        // (NaN is in no range.)
        match ranges.into_iter().find(|(_, value, range)| !range.contains(value)) {
            Some((key, value, range)) => {
                Err(format!("{key} = {value}: write {} to {}", range.start(), range.end()))
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "\
name = \"x\"
source = \"a test\"
duplex = \"half\"
latency_ms = 1.5
queue_kib = 64
mtu = 1472
";

    #[test]
    fn built_in_profiles_are_valid_and_come_back_from_their_text() {
        let all = LinkProfile::built_in().unwrap();
        let names: Vec<_> = all.iter().map(|profile| profile.name.as_str()).collect();
        assert_eq!(names, ["loopback", "wired", "lan100", "wifi-ac", "phone", "wan"]);
        for profile in &all {
            assert_eq!(LinkProfile::parse(&profile.to_toml().unwrap(), "x").as_ref(), Ok(profile));
            assert_eq!(LinkProfile::find(&profile.name).as_ref(), Ok(profile));
            assert_eq!(profile.is_straight(), profile.name == "loopback");
        }
    }

    #[test]
    fn a_file_is_checked_key_by_key() {
        assert_eq!(LinkProfile::parse(GOOD, "x").unwrap().mbit_up, None);
        let check = |from: &str, to: &str, says: &[&str]| {
            let error = LinkProfile::parse(&GOOD.replace(from, to), "my.toml").unwrap_err();
            for part in [&["my.toml"], says].concat() {
                assert!(error.contains(part), "{part:?} is not in {error:?}");
            }
        };
        check("latency_ms = 1.5", "latency_ms = -1", &["latency_ms = -1", "0 to 10000"]);
        check("latency_ms = 1.5", "latency_ms = nan", &["latency_ms = NaN"]);
        check("latency_ms = 1.5\n", "", &["latency_ms"]);
        check("mtu = 1472", "mtu = 1000", &["mtu = 1000", "1200 to 65507"]);
        check("queue_kib = 64", "queue_kib = 64\nloss = 0.6", &["loss = 0.6", "0 to 0.5"]);
        check("queue_kib = 64", "queue_kib = 64\nmbit_up = 0", &["mbit_up = 0"]);
        check("queue_kib = 64", "queue_kib = 64\nmbit = 3", &["line 6", "mbit"]);
        check("half", "some", &["line 3", "some"]);
        check("name = \"x\"", "name = \"\"", &["name: write one line"]);
        check("name = \"x\"", "name = \"../x\"", &["name: write letters"]);
        check("name = \"x\"", "name = \"Wi-Fi 5/6\"", &["name: write letters"]);
    }

    #[test]
    fn what_is_neither_a_name_nor_a_file_is_told_with_the_names() {
        let error = LinkProfile::find("no-such-link").unwrap_err();
        assert!(error.contains("no-such-link") && error.contains("lan100, wifi-ac"), "{error}");
    }
}
