//! `--device-speed`: how fast each worker is.

use std::path::Path;

/// Speeds that a device can have beside the recorded one, or this machine's core.
const SPEEDS: std::ops::RangeInclusive<f64> = 1e-3..=1e3;

/// Workers that a list can name: those of the largest simulated cluster.
pub const WORKERS_MAX: usize = 10_000;

/// A core's share that is left to the master, the relay and the system.
const LEFT_OVER: f64 = 0.5;

/// The speed of each of `workers`: `text` is one speed for all, a list such as `1.0,0.1x15` with one for each, or a file with such an item a
/// line.
pub fn speeds(text: &str, workers: usize) -> Result<Vec<f64>, String> {
    let is_list = text.chars().all(|c| c.is_ascii_digit() || ".,xX+- ".contains(c));
    let speeds = if is_list && !Path::new(text).is_file() {
        items(text.split(','), "--device-speed")?
    } else {
        let file = std::fs::read_to_string(text).map_err(|e| {
            format!(
                "--device-speed {text}: neither speeds, as in 1.0,0.1x15, nor a file that can be read: {e}"
            )
        })?;
        items(file.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#')), text)?
    };
    match speeds[..] {
        [speed] => Ok(vec![speed; workers]),
        _ if speeds.len() == workers => Ok(speeds),
        _ => Err(format!("{text}: speeds of {} devices, and there are {workers} workers", speeds.len())),
    }
}

/// Whether devices that render can have these speeds on a machine of so many cores: if their sum is more than it has, they are slower
/// than they say.
pub fn check_real(speeds: &[f64], cores: u32) -> Result<(), String> {
    if let Some(speed) = speeds.iter().find(|speed| **speed > 1.0) {
        return Err(format!(
            "a device of speed {speed} cannot render faster than a core of this machine; write speeds of at most 1, or play a recording"
        ));
    }
    let (sum, most) = (speeds.iter().sum::<f64>(), f64::from(cores) - LEFT_OVER);
    // Sums of decimal fractions are not exact.
    if sum > most + 1e-9 {
        return Err(format!(
            "devices of speed {sum:.3} together need as many cores, and this machine has {cores} of which {LEFT_OVER} is left over for the \
             master; make them slower ({:.4} times) or fewer, or play a recording",
            (most / sum).max(0.0)
        ));
    }
    Ok(())
}

/// Speeds of `items`, each with how many devices have it; `origin` is named in errors.
fn items<'a>(items: impl Iterator<Item = &'a str>, origin: &str) -> Result<Vec<f64>, String> {
    let mut speeds = Vec::new();
    for item in items {
        let item = item.trim();
        let (speed, count) = item.split_once(['x', 'X']).unwrap_or((item, "1"));
        let speed = speed.trim().parse().ok().filter(|speed| SPEEDS.contains(speed));
        let count = count.trim().parse().ok().filter(|count| (1..=WORKERS_MAX).contains(count));
        let (Some(speed), Some(count)) = (speed, count) else {
            return Err(format!(
                "{origin}: `{item}` is no speed of {} to {}, nor SPEEDxCOUNT, as in 0.1x15",
                SPEEDS.start(),
                SPEEDS.end()
            ));
        };
        speeds.extend(std::iter::repeat_n(speed, count));
        if speeds.len() > WORKERS_MAX {
            return Err(format!("{origin}: more than {WORKERS_MAX} devices"));
        }
    }
    if speeds.is_empty() { Err(format!("{origin}: no speed")) } else { Ok(speeds) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_and_files_name_a_speed_for_each() {
        assert_eq!(speeds("0.5", 3), Ok(vec![0.5; 3]));
        assert_eq!(speeds("1.0, 0.1x3", 4), Ok(vec![1.0, 0.1, 0.1, 0.1]));
        assert_eq!(speeds("2x2", 2), Ok(vec![2.0, 2.0]));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("speeds.txt");
        std::fs::write(&file, "# one fast\n1\n\n0.25 x 2\n").unwrap();
        assert_eq!(speeds(&file.display().to_string(), 3), Ok(vec![1.0, 0.25, 0.25]));
        std::fs::write(&file, "1\nfast\n").unwrap();
        let error = speeds(&file.display().to_string(), 3).unwrap_err();
        assert!(error.contains("speeds.txt") && error.contains("`fast`"), "{error}");
    }

    #[test]
    fn what_is_no_list_is_told() {
        let check = |text: &str, workers, says: &str| {
            let error = speeds(text, workers).unwrap_err();
            assert!(error.contains(says), "{text}: {error}");
        };
        check("1,0.1x15", 4, "speeds of 16 devices, and there are 4 workers");
        check("", 1, "`` is no speed");
        check("0", 1, "`0` is no speed of 0.001 to 1000");
        check("-1", 1, "`-1` is no speed");
        check("1x0", 1, "`1x0`");
        check("1x999999999999", 1, "no speed");
        check("nan", 1, "neither speeds");
        check("1,,1", 3, "`` is no speed");
    }

    #[test]
    fn real_devices_fit_into_the_machine() {
        assert_eq!(check_real(&[1.0, 0.5], 2), Ok(()));
        assert_eq!(check_real(&[0.1; 15], 2), Ok(()));
        assert!(check_real(&[0.1; 16], 2).unwrap_err().contains("0.9375 times"));
        assert!(check_real(&[1.5], 4).unwrap_err().contains("play a recording"));
    }
}
