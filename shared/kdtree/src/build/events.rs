//! Where boxes begin and end along an axis.

use super::clip::Cell;

/// One end of a box along an axis, in a form whose integer order is the sweep's order: position, then end before flat box
/// before start (else a box that ends where another starts would count on both sides), then index.
///
/// Bits 32..64: position, as an order-preserving integer; 30..32: kind; 0..30: index of the triangle in its set.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Event(u64);

const KIND_SHIFT: u32 = 30;
const INDEX_MASK: u64 = (1 << KIND_SHIFT) - 1;

/// What happens at an event.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// A box ends.
    End = 0,
    /// A box without extent along the axis.
    Flat = 1,
    /// A box begins.
    Start = 2,
}

const _: () = assert!(size_of::<Event>() == 8);
const _: () = assert!(crate::node::MAX_SLOTS as u64 <= INDEX_MASK);

impl Event {
    fn new(position: f32, kind: Kind, index: u32) -> Self {
        Self(u64::from(order_key(position)) << 32 | (kind as u64) << KIND_SHIFT | u64::from(index))
    }

    /// The position as an integer of the same order; equal for equal positions.
    #[inline]
    pub fn key(self) -> u32 {
        (self.0 >> 32) as u32
    }

    /// Whether the event is of `kind`.
    #[inline]
    pub fn is(self, kind: Kind) -> bool {
        (self.0 >> KIND_SHIFT) & 3 == kind as u64
    }

    #[inline]
    pub fn index(self) -> usize {
        (self.0 & INDEX_MASK) as usize
    }

    /// The same event of the triangle that has `index` in another set.
    #[inline]
    pub fn with_index(self, index: u32) -> Self {
        Self(self.0 & !INDEX_MASK | u64::from(index))
    }
}

/// Appends the one or two events of `bounds` along `axis`.
pub(super) fn push_events(events: &mut Vec<Event>, bounds: &Cell, axis: usize, index: u32) {
    let (min, max) = (bounds.min[axis], bounds.max[axis]);
    if min == max {
        events.push(Event::new(min, Kind::Flat, index));
    } else {
        events.push(Event::new(min, Kind::Start, index));
        events.push(Event::new(max, Kind::End, index));
    }
}

/// Maps finite floats to integers of the same order, both zeros to one.
fn order_key(position: f32) -> u32 {
    let bits = (position + 0.0).to_bits();
    if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }
}

/// The position behind a key.
#[inline]
pub(super) fn position(key: u32) -> f32 {
    f32::from_bits(if key >> 31 == 1 { key & !(1 << 31) } else { !key })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integer_order_is_position_then_end_flat_start_then_index() {
        let sorted = [
            Event::new(f32::MIN, Kind::Start, 9),
            Event::new(-1.5, Kind::Flat, 0),
            Event::new(-0.0, Kind::End, 5),
            Event::new(0.0, Kind::Flat, 4),
            Event::new(-0.0, Kind::Start, 2),
            Event::new(0.0, Kind::Start, 3),
            Event::new(1e-40, Kind::End, 1),
            Event::new(f32::MAX, Kind::End, 0),
        ];
        assert!(sorted.is_sorted());
    }

    #[test]
    fn fields_survive_packing() {
        for at in [-3.5, 0.0, 7.25e8, f32::MIN_POSITIVE] {
            let event = Event::new(at, Kind::Flat, INDEX_MASK as u32);
            assert_eq!(position(event.key()), at);
            assert!(event.is(Kind::Flat) && !event.is(Kind::Start) && !event.is(Kind::End));
            assert_eq!(event.index(), INDEX_MASK as usize);
            assert_eq!(event.with_index(3).index(), 3);
            assert_eq!(event.with_index(3).key(), event.key());
        }
    }
}
