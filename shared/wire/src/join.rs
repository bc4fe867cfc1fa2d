//! What a stranger needs to join a master: one line of text.

use bincode::{Decode, Encode};
use std::{fmt, str::FromStr};

/// Where a master is, how it proves that it is the one, and what lets a stranger in.
///
/// As text: `tessera1.HOST:PORT.FINGERPRINT.TOKEN.CHECK`, everything behind the port in lower-case hexadecimal. An IPv6 address
/// stands without brackets, which some shells take for a pattern: the port is what follows the last colon.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct JoinString {
    /// A name or an IP address without brackets; looked up at each attempt to join.
    pub host: String,
    /// The UDP port.
    pub port: u16,
    /// Of the master's certificate.
    pub fingerprint: Fingerprint,
    /// What the master gives to those who may join.
    pub token: Token,
}

/// SHA-256 of a certificate in DER, as `openssl x509 -fingerprint -sha256` shows it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Encode, Decode)]
pub struct Fingerprint(pub [u8; 32]);

/// 128 random bits. Whoever knows them may join; they are compared in constant time and never printed by `Debug`.
#[derive(Clone, Copy, Default, Eq, Encode, Decode)]
pub struct Token(pub [u8; 16]);

/// Why a text is no [`JoinString`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JoinStringError {
    /// Something else entirely.
    #[error("this is no join string: it begins with `tessera1.`, as the master has printed it")]
    NotOne,
    /// A form that this build does not know.
    #[error("this join string is of another version of tessera: use the same version on both sides")]
    Version,
    /// Its end is missing.
    #[error("the join string is cut off: copy the whole line that the master has printed")]
    Cut,
    /// A character differs.
    #[error("the join string is damaged: copy the line again that the master has printed")]
    Damaged,
    /// The host or the port.
    #[error("`{0}` is no address of a master: it must be HOST:PORT, an IPv6 address in brackets or not")]
    Address(String),
}

impl JoinString {
    const PREFIX: &str = "tessera1.";

    /// `HOST:PORT` for people, with the brackets of an IPv6 address.
    pub fn address(&self) -> String {
        if self.host.contains(':') {
            format!("[{}]:{}", self.host, self.port)
        } else {
            format!("{}:{}", self.host, self.port)
        }
    }

    /// Host and port of `HOST:PORT`.
    pub fn split_address(text: &str) -> Result<(String, u16), JoinStringError> {
        let wrong = || JoinStringError::Address(text.chars().filter(|c| !c.is_control()).take(80).collect());
        let (host, port) = text.rsplit_once(':').ok_or_else(wrong)?;
        let port = port.parse().ok().filter(|&port| port > 0).ok_or_else(wrong)?;
        Ok((Self::check_host(host).ok_or_else(wrong)?, port))
    }

    /// `host` without brackets, if it can be a name or an address.
    pub fn check_host(host: &str) -> Option<String> {
        let bare = host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(host);
        // The longest name of the domain name system; what an address with a zone takes beside.
        let fits = (1..=253).contains(&bare.len());
        let plain = bare.bytes().all(|b| b.is_ascii_alphanumeric() || b"._-:%".contains(&b));
        (fits && plain).then(|| bare.to_owned())
    }
}

impl fmt::Display for JoinString {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = format!("{}{}:{}.{}.", Self::PREFIX, self.host, self.port, self.fingerprint);
        text.extend(self.token.0.iter().map(|byte| format!("{byte:02x}")));
        write!(f, "{text}.{:08x}", crc32(text.as_bytes()))
    }
}

impl FromStr for JoinString {
    type Err = JoinStringError;

    fn from_str(text: &str) -> Result<Self, JoinStringError> {
        let text = text.trim();
        let Some(rest) = text.strip_prefix(Self::PREFIX) else {
            let number = text.strip_prefix("tessera").and_then(|rest| rest.split('.').next());
            let other = number.is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()));
            // The prefix itself may be what was cut.
            let cut = !text.is_empty() && Self::PREFIX.starts_with(text);
            return Err(match (cut, other) {
                (true, _) => JoinStringError::Cut,
                (false, true) => JoinStringError::Version,
                (false, false) => JoinStringError::NotOne,
            });
        };
        let mut parts = rest.rsplitn(4, '.');
        let (Some(check), Some(token), Some(fingerprint), Some(address)) =
            (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            return Err(JoinStringError::Cut);
        };
        if (fingerprint.len(), token.len()) != (64, 32) || check.len() < 8 {
            return Err(JoinStringError::Cut);
        }
        let sum = u32::from_be_bytes(from_hex(check).ok_or(JoinStringError::Damaged)?);
        if sum != crc32(&text.as_bytes()[..text.len() - check.len() - 1]) {
            return Err(JoinStringError::Damaged);
        }
        let (host, port) = Self::split_address(address)?;
        Ok(Self {
            host,
            port,
            fingerprint: Fingerprint(from_hex(fingerprint).ok_or(JoinStringError::Damaged)?),
            token: Token(from_hex(token).ok_or(JoinStringError::Damaged)?),
        })
    }
}

impl PartialEq for Token {
    /// Takes the same time wherever the first difference is.
    fn eq(&self, other: &Self) -> bool {
        let differing = self.0.iter().zip(&other.0).fold(0, |bits, (a, b)| bits | (a ^ b));
        std::hint::black_box(differing) == 0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Fingerprint({self})")
    }
}

/// `N` bytes of exactly `2 N` hexadecimal digits.
fn from_hex<const N: usize>(text: &str) -> Option<[u8; N]> {
    let digit = |b: u8| char::from(b).to_digit(16).map(|d| d as u8);
    let mut bytes = [0; N];
    if text.len() != 2 * N {
        return None;
    }
    for (byte, pair) in bytes.iter_mut().zip(text.as_bytes().chunks_exact(2)) {
        *byte = digit(pair[0])? << 4 | digit(pair[1])?;
    }
    Some(bytes)
}

/// The CRC-32 of IEEE 802.3 (reflected polynomial 0xEDB88320): it finds every change of up to four bytes next to each other.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
    !bytes.iter().fold(!0, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), step))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(host: &str) -> JoinString {
        let host = host.to_owned();
        JoinString { host, port: 7411, fingerprint: Fingerprint([0xAB; 32]), token: Token([0x5C; 16]) }
    }

    #[test]
    fn a_join_string_survives_being_printed_and_pasted() {
        for host in ["127.0.0.1", "::1", "fe80::1%eth0", "master", "render-1.example.org"] {
            let join = sample(host);
            assert_eq!(format!("  {join}\n").parse(), Ok(join));
        }
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926, "the check value of the standard");
        assert_eq!(sample("::1").address(), "[::1]:7411");
        assert_eq!(sample("master").address(), "master:7411");
        assert!(!format!("{:?}", sample("m")).contains("5c"), "a log must not let anyone in");
    }

    #[test]
    fn every_cut_and_every_changed_character_is_found() {
        let text = sample("127.0.0.1").to_string();
        for end in 0..text.len() {
            let error = text[..end].parse::<JoinString>().expect_err(&text[..end]);
            let expected = if end == 0 { JoinStringError::NotOne } else { JoinStringError::Cut };
            assert_eq!(error, expected, "{}", &text[..end]);
        }
        for at in 0..text.len() {
            for other in ["x", "0", ".", "7", "\u{e9}"] {
                let mut changed = text.clone();
                changed.replace_range(at..=at, other);
                assert!(changed == text || changed.parse::<JoinString>().is_err(), "{changed}");
            }
        }
        assert_eq!(format!("{text}0").parse::<JoinString>(), Err(JoinStringError::Damaged));
        assert_eq!("https://example.org".parse::<JoinString>(), Err(JoinStringError::NotOne));
        assert_eq!(text.replace("tessera1", "tessera2").parse::<JoinString>(), Err(JoinStringError::Version));
    }

    #[test]
    fn addresses() {
        let split = JoinString::split_address;
        assert_eq!(split("[::1]:80"), Ok(("::1".into(), 80)));
        assert_eq!(split("::1:80"), Ok(("::1".into(), 80)));
        assert_eq!(split("master:7411"), Ok(("master".into(), 7411)));
        for bad in ["", "master", "master:", "master:0", "master:65536", ":80", "a b:80", "a\x1b:80", "a/b:1"]
        {
            assert!(matches!(split(bad), Err(JoinStringError::Address(_))), "{bad}");
        }
    }

    #[test]
    fn tokens_differ_in_any_bit() {
        let token = Token([7; 16]);
        assert_eq!(token, token);
        for bit in 0..128 {
            let mut other = token;
            other.0[bit / 8] ^= 1 << (bit % 8);
            assert_ne!(token, other);
        }
    }
}
