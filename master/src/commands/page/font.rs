//! A font of strokes, so that pictures need none of the system's. Its widths are near those of common sans-serif fonts, and are what
//! layouts measure with.

use super::canvas::Place;

/// Size of the font, as fonts count it, in units of the glyphs.
const UNITS: f64 = 19.5;
/// The digit of the base line.
const BASE: f64 = 4.0;

/// Width of `text` in a font of `size`.
pub fn width(text: &str, size: f64) -> f64 {
    text.chars().map(|c| glyph(c).0).sum::<f64>() * size / UNITS
}

/// `text`, with an end cut off and `…` in its place if it is wider than `room`.
pub fn shortened(text: &str, size: f64, room: f64) -> String {
    if width(text, size) <= room {
        return text.to_owned();
    }
    let room = room - width("…", size);
    let mut used = 0.0;
    let fits = |c: &char| {
        used += glyph(*c).0 * size / UNITS;
        used <= room
    };
    let kept: String = text.chars().take_while(fits).collect();
    format!("{}…", kept.trim_end())
}

/// One step of a pen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pen {
    /// Puts it down.
    Down(Place),
    /// Draws a line.
    Line(Place),
    /// Draws a parabola with a control point.
    Curve(Place, Place),
}

/// Strokes of `text` in a font of `size`, from (0, 0) on the base line to the right; y points down.
pub fn strokes(text: &str, size: f64) -> Vec<Pen> {
    let scale = size / UNITS;
    let mut steps = Vec::new();
    let mut left = 0.0;
    for c in text.chars() {
        let (advance, strokes) = glyph(c);
        let place = |(x, y): Place| ((left + x) * scale, (BASE - y) * scale);
        for stroke in strokes.split('/').filter(|stroke| !stroke.is_empty()) {
            // Points with a `~` are controls; between two of them lies a point that is not written.
            let mut control: Option<Place> = None;
            for (k, point) in stroke.split(' ').enumerate() {
                let is_control = point.starts_with('~');
                let mut digits = point.trim_start_matches('~').chars().map(|c| c.to_digit(36).unwrap_or(0));
                let to = (f64::from(digits.next().unwrap_or(0)), f64::from(digits.next().unwrap_or(0)));
                match (is_control, control) {
                    (true, Some(before)) => {
                        let middle = ((before.0 + to.0) / 2.0, (before.1 + to.1) / 2.0);
                        steps.push(Pen::Curve(place(before), place(middle)));
                    }
                    (true, None) => {}
                    (false, Some(before)) => steps.push(Pen::Curve(place(before), place(to))),
                    (false, None) if k == 0 => steps.push(Pen::Down(place(to))),
                    (false, None) => steps.push(Pen::Line(place(to))),
                }
                control = is_control.then_some(to);
            }
        }
        left += advance;
    }
    steps
}

/// Advance and strokes of a character; a box for one that is not in the table.
fn glyph(c: char) -> (f64, &'static str) {
    if c.is_control() {
        return (0.0, "");
    }
    let at = GLYPHS.binary_search_by_key(&c, |glyph| glyph.0);
    match at {
        Ok(at) => (GLYPHS[at].1, GLYPHS[at].2),
        // East Asian characters are twice as wide as others.
        Err(_) if c >= '\u{2e80}' => (20.0, "24 2i ii i4 24"),
        Err(_) => (12.0, "24 2i ai a4 24"),
    }
}

/// By character: advance, and strokes with `/` between them. A point is two digits to base 36, to the right and up. Heights: 0 descenders,
/// 4 base line, e small letters, i capitals.
const GLYPHS: [(char, f64, &str); 107] = [
    (' ', 5.5, ""),
    ('!', 5.0, "28 2i/24 25"),
    ('"', 7.0, "2f 2i/5f 5i"),
    ('#', 12.0, "34 5i/74 9i/19 a9/2d bd"),
    ('$', 11.0, "8f ~7h 5h ~2h 2e ~2c 5b ~8a 88 ~85 55 ~35 27/5j 53"),
    ('%', 17.0, "2f ~2i ~7i 7f ~7c ~2c 2f/a7 ~aa ~fa f7 ~f4 ~a4 a7/44 di"),
    ('&', 13.0, "b4 4e ~3i 6i ~8i 8f ~8d 5c ~2a 27 ~24 64 ~94 ba"),
    ('\'', 4.0, "2f 2i"),
    ('(', 6.5, "5j ~2g 2a ~24 51"),
    (')', 6.5, "1j ~4g 4a ~44 11"),
    ('*', 8.0, "4i 4c/1h 7d/7h 1d"),
    ('+', 11.0, "29 99/5d 55"),
    (',', 5.0, "25 24 12"),
    ('-', 7.0, "29 59"),
    ('.', 5.0, "24 25"),
    ('/', 6.0, "12 5i"),
    ('0', 11.0, "28 2e ~2i ~9i 9e 98 ~94 ~24 28"),
    ('1', 11.0, "3f 6i 64"),
    ('2', 11.0, "2e ~2i ~9i 9e ~9b 24 94"),
    ('3', 11.0, "2g ~3i 5i ~8i ~8b 5b ~9b ~94 54 ~34 26"),
    ('4', 11.0, "74 7i 28 a8"),
    ('5', 11.0, "8i 3i 2b ~3d 5d ~9d ~94 54 ~34 26"),
    ('6', 11.0, "8g ~7i 6i ~2i 29 ~24 ~94 99 ~9d ~2d 29"),
    ('7', 11.0, "2i 9i 54"),
    ('8', 11.0, "3e ~3i ~8i 8e ~8b ~3b 3e/28 ~2b ~9b 98 ~94 ~24 28"),
    ('9', 11.0, "36 ~44 54 ~94 9d ~9i ~2i 2d ~29 ~99 9d"),
    (':', 5.0, "24 25/2d 2e"),
    (';', 5.0, "25 24 12/2d 2e"),
    ('<', 11.0, "9e 29 94"),
    ('=', 11.0, "2b 9b/27 97"),
    ('>', 11.0, "2e 99 24"),
    ('?', 10.0, "2f ~2i ~8i 8e ~8c 5a 58/54 55"),
    ('@', 19.0, "f4 ~d2 a2 ~22 2a ~2i 9i ~gi ga ~g6 e6 ~c6 c8/6a ~6e ~ce ca ~c6 ~66 6a"),
    ('A', 12.5, "14 6i b4/39 99"),
    ('B', 12.5, "24 2i 6i ~ai ~ab 6b 2b/6b ~bb ~b4 64 24"),
    ('C', 13.5, "bf ~ai 7i ~2i 2d 29 ~24 74 ~a4 b7"),
    ('D', 13.5, "24 2i 5i ~bi bd b9 ~b4 54 24"),
    ('E', 12.0, "a4 24 2i ai/2b 9b"),
    ('F', 11.5, "24 2i 9i/2b 8b"),
    ('G', 14.5, "cf ~bi 7i ~2i 2d 29 ~24 74 ~c4 c8 cb 8b"),
    ('H', 13.0, "24 2i/b4 bi/2b bb"),
    ('I', 4.5, "24 2i"),
    ('J', 9.5, "7i 78 ~74 44 ~14 17"),
    ('K', 12.0, "24 2i/bi 29/5c b4"),
    ('L', 10.5, "2i 24 94"),
    ('M', 14.5, "24 2i 78 ci c4"),
    ('N', 13.0, "24 2i b4 bi"),
    ('O', 14.5, "2d ~2i 7i ~ci cd c9 ~c4 74 ~24 29 2d"),
    ('P', 12.0, "24 2i 6i ~ai ~aa 6a 2a"),
    ('Q', 14.5, "2d ~2i 7i ~ci cd c9 ~c4 74 ~24 29 2d/97 d3"),
    ('R', 12.5, "24 2i 6i ~ai ~aa 6a 2a/6a b4"),
    ('S', 12.0, "af ~9i 6i ~2i 2e ~2c 6b ~aa a8 ~a4 64 ~34 27"),
    ('T', 12.0, "1i bi/6i 64"),
    ('U', 13.0, "2i 29 ~24 ~b4 b9 bi"),
    ('V', 12.0, "1i 64 bi"),
    ('W', 16.5, "1i 54 8i b4 fi"),
    ('X', 12.0, "1i b4/bi 14"),
    ('Y', 12.0, "1i 6b bi/6b 64"),
    ('Z', 12.0, "2i ai 24 a4"),
    ('[', 6.5, "5j 2j 21 51"),
    ('\\', 6.0, "1i 52"),
    (']', 6.5, "1j 4j 41 11"),
    ('^', 10.0, "2c 5i 8c"),
    ('_', 11.0, "11 a1"),
    ('`', 5.0, "1i 3f"),
    ('a', 10.5, "2c ~3e 5e ~8e 8b 84/8a 5a ~2a 27 ~24 44 ~74 87"),
    ('b', 11.0, "24 2i/2b ~3e 5e ~9e 99 ~94 54 ~34 27"),
    ('c', 10.0, "8c ~7e 5e ~2e 2a 28 ~24 54 ~74 86"),
    ('d', 11.0, "94 9i/9b ~8e 6e ~2e 29 ~24 64 ~84 97"),
    ('e', 11.0, "29 99 ~9e ~2e 29 ~24 64 ~84 96"),
    ('f', 6.5, "6i ~3i 3f 34/1e 6e"),
    ('g', 11.0, "9e 93 ~90 50 ~30 22/9b ~8e 6e ~2e 29 ~24 64 ~84 97"),
    ('h', 11.0, "24 2i/2b ~3e 6e ~9e 9b 94"),
    ('i', 4.5, "24 2e/2h 2i"),
    ('j', 4.5, "2e 22 ~20 00/2h 2i"),
    ('k', 10.0, "24 2i/8e 28/4a 94"),
    ('l', 5.5, "2i 26 ~24 44"),
    ('m', 16.5, "24 2e/2b ~3e 5e ~8e 8b 84/8b ~9e be ~ee eb e4"),
    ('n', 11.0, "24 2e/2b ~3e 6e ~9e 9b 94"),
    ('o', 11.0, "29 ~2e ~9e 99 ~94 ~24 29"),
    ('p', 11.0, "20 2e/2b ~3e 5e ~9e 99 ~94 54 ~34 27"),
    ('q', 11.0, "90 9e/9b ~8e 6e ~2e 29 ~24 64 ~84 97"),
    ('r', 7.0, "24 2e/2a ~3e 6e"),
    ('s', 10.0, "8c ~7e 5e ~2e 2c ~2a 59 ~88 86 ~84 54 ~34 26"),
    ('t', 6.5, "3h 36 ~34 64/1e 6e"),
    ('u', 11.0, "2e 27 ~24 54 ~84 97/9e 94"),
    ('v', 10.0, "1e 54 9e"),
    ('w', 14.0, "1e 44 7e a4 de"),
    ('x', 10.0, "2e 84/8e 24"),
    ('y', 10.0, "1e 54/9e 42 ~30 10"),
    ('z', 10.0, "2e 8e 24 84"),
    ('{', 7.0, "5j ~3j 3h 3c ~3a 1a ~3a 38 33 ~31 51"),
    ('|', 4.5, "2j 21"),
    ('}', 7.0, "1j ~3j 3h 3c ~3a 5a ~3a 38 33 ~31 11"),
    ('~', 11.0, "28 ~3b 59 ~77 9a"),
    ('±', 11.0, "2a 9a/5e 56/24 94"),
    ('²', 7.0, "2g ~2i ~5i 5g 2c 5c"),
    ('µ', 11.0, "20 2e/2e 27 ~24 54 ~84 97/9e 94"),
    ('·', 5.0, "29 2a"),
    ('×', 10.0, "26 8c/2c 86"),
    ('–', 11.0, "29 99"),
    ('…', 15.0, "24 25/74 75/c4 c5"),
    ('→', 14.0, "29 c9/8d c9 85"),
    ('−', 11.0, "29 99"),
    ('≈', 11.0, "2b ~3e 5c ~7a 9d/26 ~39 57 ~75 98"),
    ('≤', 11.0, "9f 2b 97/24 94"),
    ('≥', 11.0, "2f 9b 27/24 94"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_glyph_can_be_drawn_inside_its_width() {
        assert!(GLYPHS.is_sorted_by(|a, b| a.0 < b.0));
        for (c, advance, strokes) in GLYPHS {
            for point in strokes.split(['/', ' ']).filter(|point| !point.is_empty()) {
                let digits: Vec<_> = point.trim_start_matches('~').chars().map(|c| c.to_digit(36)).collect();
                let [Some(x), Some(y)] = digits[..] else { panic!("{c}: {point}") };
                assert!(f64::from(x) <= advance && y <= 19, "{c}: {point}");
            }
            for stroke in strokes.split('/').filter(|stroke| !stroke.is_empty()) {
                let ends = [stroke.split(' ').next(), stroke.split(' ').next_back()];
                assert!(ends.iter().flatten().all(|end| !end.starts_with('~')), "{c}: {stroke}");
            }
        }
        assert!((' '..='~').all(|c| GLYPHS.iter().any(|glyph| glyph.0 == c)));
    }

    #[test]
    fn curves_pass_between_their_controls() {
        // An `o`: four controls around it, so four curves, and the end is the start.
        let steps = strokes("o", UNITS);
        assert_eq!(steps.len(), 5);
        assert_eq!(steps[0], Pen::Down((2.0, -5.0)));
        assert_eq!(steps[1], Pen::Curve((2.0, -10.0), (5.5, -10.0)));
        assert!(matches!(steps[4], Pen::Curve(_, end) if end == (2.0, -5.0)));
    }

    #[test]
    fn long_texts_are_cut_to_the_room() {
        assert_eq!(shortened("short", 13.0, 100.0), "short");
        let cut = shortened("a name that is far too long", 13.0, 100.0);
        assert!(cut.ends_with('…') && width(&cut, 13.0) <= 100.0 && width(&cut, 13.0) > 80.0, "{cut}");
        assert_eq!(shortened("name", 13.0, 0.0), "…");
        assert!(width("\u{4e16}", 13.0) > width("w", 13.0));
    }
}
