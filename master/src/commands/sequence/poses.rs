//! Where a camera goes: poses in files and on stdin, and what lies between them.

use serde::Deserialize;
use std::io::{BufRead, Read};
use std::path::Path;
use tessera_geometry::{CameraPose, DVec3};
use toml::Spanned;

/// Most frames of a sequence: more than nine hours at 30 a second.
pub const FRAMES_MAX: u32 = 1_000_000;

/// Bytes of a path file: a pose takes some 100.
const FILE_BYTES_MAX: u64 = 64 << 20;

/// Bytes of a line: a pose takes some 100.
const LINE_BYTES_MAX: usize = 4096;

/// A pose as a user writes it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    eye: [f64; 3],
    target: [f64; 3],
    up: Option<[f64; 3]>,
    fov: Option<f64>,
    time: Option<f64>,
}

/// A pose, and when it is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key {
    /// The view.
    pub pose: CameraPose,
    /// In seconds.
    pub time: Option<f64>,
}

impl Entry {
    /// `fov`: where the entry has none.
    fn key(&self, fov: f64) -> Result<Key, String> {
        let [eye, target, up] = [self.eye, self.target, self.up.unwrap_or(CameraPose::DEFAULT_UP.to_array())]
            .map(DVec3::from_array);
        let fov_degrees = self.fov.unwrap_or(fov);
        if !(eye.is_finite() && target.is_finite() && up.is_finite()) {
            return Err("eye, target and up must be finite numbers".into());
        }
        if !(fov_degrees > 0.0 && fov_degrees < 180.0) {
            return Err("fov must lie between 0 and 180 degrees".into());
        }
        if self.time.is_some_and(|time| !time.is_finite()) {
            return Err("time must be a finite number of seconds".into());
        }
        Ok(Key { pose: CameraPose { eye, target, up, fov_degrees }, time: self.time })
    }
}

/// One pose as a line of JSON.
fn parse_line(line: &str, fov: f64) -> Result<Key, String> {
    let entry: Entry = serde_json::from_str(line).map_err(|e| {
        // The line is one: its number is the caller's to say.
        let text = e.to_string();
        text.split(" at line ").next().unwrap_or("no pose").to_owned()
    })?;
    entry.key(fov)
}

/// Reads poses from a stream, a line each, until it ends, or one is none or not taken; `take` says why, or whether it wants more. The error
/// names the line.
pub fn read_lines(
    mut from: impl BufRead,
    fov: f64,
    mut take: impl FnMut(Key) -> Result<bool, String>,
) -> Result<(), String> {
    let mut line = Vec::new();
    for number in 1_u64.. {
        line.clear();
        let of = |what: String| format!("line {number}: {what}");
        let length = from.by_ref().take(LINE_BYTES_MAX as u64 + 1).read_until(b'\n', &mut line);
        if length.map_err(|e| of(format!("cannot be read: {e}")))? == 0 {
            return Ok(());
        }
        if line.len() > LINE_BYTES_MAX {
            return Err(of(format!("it is longer than {LINE_BYTES_MAX} bytes; write one pose a line")));
        }
        let text = std::str::from_utf8(&line).map_err(|_| of("it is no UTF-8".into()))?.trim();
        if text.is_empty() {
            continue;
        }
        if !parse_line(text, fov).and_then(&mut take).map_err(of)? {
            return Ok(());
        }
    }
    Ok(())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    pose: Vec<Spanned<Entry>>,
}

/// Reads a path file: TOML if its name ends so, else a pose a line in JSON. The error names the file, and the line.
pub fn read_file(path: &Path, fov: f64) -> Result<Vec<Key>, String> {
    let of = |what: String| format!("{}: {what}", path.display());
    let metadata = std::fs::metadata(path).map_err(|e| of(format!("cannot be read: {e}")))?;
    if !metadata.is_file() {
        return Err(of("is not a regular file; name a file, or give poses on stdin with --poses -".into()));
    }
    if metadata.len() > FILE_BYTES_MAX {
        return Err(of(format!("has {} bytes, more than the {FILE_BYTES_MAX} of a path", metadata.len())));
    }
    let text = std::fs::read(path).map_err(|e| of(format!("cannot be read: {e}")))?;
    let text = String::from_utf8(text).map_err(|_| of("is no UTF-8 text".into()))?;
    let is_toml = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
    let keys = if is_toml { parse_toml(&text, fov) } else { parse_json_lines(&text, fov) };
    let keys = keys.map_err(of)?;
    check(&keys).map_err(of)?;
    Ok(keys)
}

fn parse_json_lines(text: &str, fov: f64) -> Result<Vec<Key>, String> {
    let mut keys = Vec::new();
    read_lines(text.as_bytes(), fov, |key| {
        keys.push(key);
        Ok(true)
    })?;
    Ok(keys)
}

fn parse_toml(text: &str, fov: f64) -> Result<Vec<Key>, String> {
    let line = |at: usize| 1 + text.get(..at).unwrap_or(text).matches('\n').count();
    let file: File = toml::from_str(text).map_err(|e| {
        let at = e.span().map_or(0, |span| span.start);
        format!("line {}: {}", line(at), e.message())
    })?;
    let key = |entry: &Spanned<Entry>| {
        entry.get_ref().key(fov).map_err(|what| format!("line {}: {what}", line(entry.span().start)))
    };
    file.pose.iter().map(key).collect()
}

/// Whether the keys make a path: there are some, and their times, if they have any, ascend.
fn check(keys: &[Key]) -> Result<(), String> {
    if keys.is_empty() {
        return Err("has no pose; give some, in TOML as [[pose]] with eye and target".into());
    }
    let timed = keys.iter().filter(|key| key.time.is_some()).count();
    if timed != 0 && timed != keys.len() {
        return Err(format!("{timed} of {} poses have a time; give one to all or to none", keys.len()));
    }
    if let Some(place) = keys.windows(2).position(|pair| timed > 0 && pair[0].time >= pair[1].time) {
        return Err(format!("pose {} is not later than the one before it", place + 2));
    }
    Ok(())
}

/// When the frames of a sequence are, from `start` to `end` seconds: `frames` of them, `fps` a second, or both.
pub fn times((start, end): (f64, f64), frames: Option<u32>, fps: Option<f64>) -> Result<Vec<f64>, String> {
    let length = (end - start).max(0.0);
    let count = match (frames, fps) {
        (Some(frames), _) => frames,
        (None, Some(fps)) => {
            // (What ends at a frame ends with it, whatever the product was rounded to.)
            let count = (length * fps + 1e-6).floor() + 1.0;
            if count > f64::from(FRAMES_MAX) {
                return Err(format!("{length} s at {fps} frames a second are more than {FRAMES_MAX} frames"));
            }
            count as u32
        }
        (None, None) => return Err("say how many: --frames N or --fps F".into()),
    };
    let step = match fps {
        Some(fps) => 1.0 / fps,
        None => length / f64::from(count.saturating_sub(1).max(1)),
    };
    Ok((0..count).map(|frame| (start + f64::from(frame) * step).min(end.max(start))).collect())
}

/// The poses of a path: those of its keys, or those at the times of its frames, on straight lines between its keys.
pub fn along(keys: &[Key], frames: Option<u32>, fps: Option<f64>) -> Result<Vec<CameraPose>, String> {
    if frames.is_none() && fps.is_none() {
        return Ok(keys.iter().map(|key| key.pose).collect());
    }
    let of_keys: Vec<_> = keys.iter().zip(0_u32..).map(|(key, n)| key.time.unwrap_or(n.into())).collect();
    let (Some(&start), Some(&end)) = (of_keys.first(), of_keys.last()) else { return Ok(Vec::new()) };
    let times = times((start, end), frames, fps)?;
    let at = |seconds: f64| {
        let after = of_keys.partition_point(|&time| time <= seconds);
        if after == 0 || after == keys.len() {
            return keys[after.saturating_sub(1)].pose;
        }
        let part = (seconds - of_keys[after - 1]) / (of_keys[after] - of_keys[after - 1]);
        let (a, b) = (keys[after - 1].pose, keys[after].pose);
        let between = |a: DVec3, b: DVec3| a + (b - a) * part;
        CameraPose {
            eye: between(a.eye, b.eye),
            target: between(a.target, b.target),
            up: between(a.up.normalize_or_zero(), b.up.normalize_or_zero()),
            fov_degrees: a.fov_degrees + (b.fov_degrees - a.fov_degrees) * part,
        }
    };
    Ok(times.into_iter().map(at).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINES: &str = "{\"eye\": [0, 0, 4], \"target\": [0, 0, 0], \"fov\": 40}\n\n\
        {\"eye\": [4, 0, 4], \"target\": [0, 2, 0], \"up\": [0, 0, 1]}\n";

    #[test]
    fn both_forms_say_the_same() {
        let toml = "[[pose]]\neye = [0, 0, 4]\ntarget = [0.0, 0, 0]\nfov = 40\n\n\
            [[pose]]\neye = [4, 0, 4]\ntarget = [0, 2, 0]\nup = [0, 0, 1]\n";
        let keys = parse_json_lines(LINES, 60.0).unwrap();
        assert_eq!(keys, parse_toml(toml, 60.0).unwrap());
        let [first, second] = keys[..] else { panic!("{keys:?}") };
        assert_eq!((first.pose.fov_degrees, first.pose.up), (40.0, DVec3::Y));
        assert_eq!((second.pose.fov_degrees, second.pose.eye.x), (60.0, 4.0));
    }

    #[test]
    fn what_is_no_pose_is_named_with_its_line() {
        let cases = [
            ("{\"eye\": [0, 0, 4]}", "line 1: missing field `target`"),
            ("\n{\"eye\": [0, 0], \"target\": [0, 0, 0]}", "line 2: invalid length 2"),
            ("{\"eye\": [0, 0, 4], \"target\": [0, 0, 0], \"fov\": 180}", "line 1: fov must lie"),
            ("{\"eye\": [0, 0, 4], \"target\": [0, 0, 0], \"roll\": 1}", "line 1: unknown field `roll`"),
            ("{\"eye\": [0, 0, 1e999], \"target\": [0, 0, 0]}", "line 1: number out of range"),
            ("hello", "line 1: expected value"),
        ];
        for (text, why) in cases {
            let error = parse_json_lines(text, 60.0).unwrap_err();
            assert!(error.starts_with(why), "{text}: {error}");
        }
        let long = format!("{}{}", LINES, " ".repeat(LINE_BYTES_MAX + 1));
        assert!(parse_json_lines(&long, 60.0).unwrap_err().starts_with("line 4: it is longer"));
        let cases = [
            ("[[pose]]\neye = [0, 0, 4]\ntarget = [0, 0, 0]\nfov = 0", "line 1: fov must lie"),
            ("\n[[pose]]\neye = [0, 0, 4]\ntarget = [nan, 0, 0]\n", "line 2: eye, target and up"),
            ("[[pose]]\neye = [0, 0, 4]\ntarget = [0, 0, 0]\nroll = 1", "line 4: unknown field `roll`"),
            ("[[pose]]\neye = [0, 0, 4\ntarget = 1", "line "),
            ("[pose]\neye = 1", "line 1: "),
        ];
        for (text, why) in cases {
            let error = parse_toml(text, 60.0).unwrap_err();
            assert!(error.starts_with(why), "{text}: {error}");
        }
        let keys = parse_json_lines(LINES, 60.0).unwrap();
        assert_eq!(check(&keys), Ok(()));
        let timed = |times: [Option<f64>; 2]| -> Vec<Key> {
            keys.iter().zip(times).map(|(key, time)| Key { time, ..*key }).collect()
        };
        assert_eq!(check(&timed([Some(1.0), Some(1.5)])), Ok(()));
        assert!(check(&timed([Some(1.0), None])).unwrap_err().contains("1 of 2 poses have a time"));
        assert!(check(&timed([Some(1.0), Some(1.0)])).unwrap_err().contains("pose 2 is not later"));
        assert!(check(&[]).unwrap_err().contains("no pose"));
    }

    #[test]
    fn frames_lie_between_keys() {
        let keys = parse_json_lines(LINES, 60.0).unwrap();
        assert_eq!(along(&keys, None, None).unwrap(), keys.iter().map(|key| key.pose).collect::<Vec<_>>());
        let five = along(&keys, Some(5), None).unwrap();
        assert_eq!(five.iter().map(|pose| pose.eye.x).collect::<Vec<_>>(), [0.0, 1.0, 2.0, 3.0, 4.0]);
        assert_eq!((five[0], five[4].target), (keys[0].pose, keys[1].pose.target));
        assert_eq!((five[2].fov_degrees, five[2].target.y), (50.0, 1.0));
        assert_eq!(along(&keys, Some(1), None).unwrap(), [keys[0].pose]);
        // A second from key to key: the end is a frame too.
        assert_eq!(along(&keys, None, Some(4.0)).unwrap(), five);
        // Who stays longer than the path stays at its end.
        assert_eq!(along(&keys, Some(7), Some(4.0)).unwrap()[6].eye.x, 4.0);
        let timed: Vec<_> =
            keys.iter().zip([2.0, 4.0]).map(|(key, t)| Key { time: Some(t), ..*key }).collect();
        assert_eq!(along(&timed, None, Some(1.0)).unwrap()[1].eye.x, 2.0);
        assert!(along(&timed, None, Some(1e9)).unwrap_err().contains("more than 1000000 frames"));
        assert_eq!(times((0.0, 0.0), Some(3), None), Ok(vec![0.0; 3]));
        assert!(times((0.0, 1.0), None, None).is_err());
    }
}
