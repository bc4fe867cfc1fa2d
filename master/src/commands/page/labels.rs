//! Room for a text beside a point.

use super::canvas::Place;

/// An area along the axes; `top` is less than `bottom`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rect {
    pub left: f64,
    pub top: f64,
    pub right: f64,
    pub bottom: f64,
}

impl Rect {
    /// What is within `across` and `along` of `centre`.
    pub fn around((x, y): Place, across: f64, along: f64) -> Self {
        Self { left: x - across, top: y - along, right: x + across, bottom: y + along }
    }

    fn touches(&self, other: &Self) -> bool {
        self.left < other.right
            && other.left < self.right
            && self.top < other.bottom
            && other.top < self.bottom
    }

    fn holds(&self, other: &Self) -> bool {
        self.left <= other.left
            && other.right <= self.right
            && self.top <= other.top
            && other.bottom <= self.bottom
    }

    /// Whether the line from `a` to `b` passes through it: the part of the line within each pair of sides, as Liang and Barsky clip.
    fn is_crossed(&self, [a, b]: [Place; 2]) -> bool {
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        for (start, step, low, high) in
            [(a.0, b.0 - a.0, self.left, self.right), (a.1, b.1 - a.1, self.top, self.bottom)]
        {
            if step == 0.0 {
                if start < low || start > high {
                    return false;
                }
                continue;
            }
            let (enters, leaves) = ((low - start) / step, (high - start) / step);
            from = from.max(enters.min(leaves));
            to = to.min(enters.max(leaves));
        }
        from <= to
    }
}

/// A place for a text of `size` (width, height) at `distance` from `point`: the first of eight around it that is inside `area` and free
/// of what is `taken` and of lines. None: there is no room.
pub fn room_for(
    size: (f64, f64),
    point: Place,
    distance: f64,
    area: &Rect,
    taken: &[Rect],
    segments: &[[Place; 2]],
) -> Option<Rect> {
    let (across, along) = (size.0 / 2.0, size.1 / 2.0);
    // Right, left, above, below; then the corners, nearer since they are farther from the point.
    let (x, y) = (across + distance, along + distance);
    let (corner_x, corner_y) = (across + 0.6 * distance, along + 0.6 * distance);
    let offsets = [
        (x, 0.0),
        (-x, 0.0),
        (0.0, -y),
        (0.0, y),
        (corner_x, -corner_y),
        (corner_x, corner_y),
        (-corner_x, -corner_y),
        (-corner_x, corner_y),
    ];
    offsets
        .into_iter()
        .map(|(right, down)| Rect::around((point.0 + right, point.1 + down), across, along))
        .find(|rect| {
            let with_air = Rect {
                left: rect.left - 2.0,
                top: rect.top - 2.0,
                right: rect.right + 2.0,
                bottom: rect.bottom + 2.0,
            };
            area.holds(&with_air)
                && !taken.iter().any(|other| other.touches(&with_air))
                && !segments.iter().any(|segment| with_air.is_crossed(*segment))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    const AREA: Rect = Rect { left: 0.0, top: 0.0, right: 100.0, bottom: 100.0 };

    #[test]
    fn labels_avoid_what_is_there() {
        let room = |point, taken: &[Rect], segments: &[[Place; 2]]| {
            room_for((20.0, 8.0), point, 5.0, &AREA, taken, segments)
        };
        let right = room((50.0, 50.0), &[], &[]).unwrap();
        assert_eq!(right, Rect { left: 55.0, top: 46.0, right: 75.0, bottom: 54.0 });
        let left = room((50.0, 50.0), &[right], &[]).unwrap();
        assert_eq!((left.left, left.right), (25.0, 45.0));
        // A line from left to right leaves what is above it.
        let above = room((50.0, 50.0), &[], &[[(0.0, 50.0), (100.0, 50.0)]]).unwrap();
        assert_eq!((above.left, above.bottom), (40.0, 45.0));
        // At the right edge.
        assert_eq!(room((90.0, 50.0), &[], &[]).unwrap().right, 85.0);
        assert_eq!(room((50.0, 50.0), &[AREA], &[]), None);
    }

    #[test]
    fn lines_cross_what_they_pass_through() {
        let rect = Rect { left: 10.0, top: 10.0, right: 20.0, bottom: 20.0 };
        for (segment, crosses) in [
            ([(0.0, 0.0), (30.0, 30.0)], true),
            ([(0.0, 15.0), (30.0, 15.0)], true),
            ([(15.0, 12.0), (15.0, 18.0)], true),
            ([(0.0, 0.0), (5.0, 5.0)], false),
            ([(0.0, 21.0), (30.0, 21.0)], false),
            ([(0.0, 12.0), (12.0, 0.0)], false),
            ([(15.0, 15.0), (15.0, 15.0)], true),
        ] {
            assert_eq!(rect.is_crossed(segment), crosses, "{segment:?}");
        }
    }
}
