//! Tiles of a frame of mixed classes that another class renders as well, and how far the two differ.

use crate::difference::Difference;
use std::{collections::BTreeMap, time::Duration};
use tessera_wire::{Attempt, TileGrid, TileId, WorkerId};

/// Tiles of an image that are compared, over all classes; each class has one at least. Enough to see a difference that is everywhere,
/// few enough to cost next to nothing.
const TILES: usize = 4;

/// Comparisons under way after the last tile is in the image.
#[derive(Clone, Debug)]
pub struct Checks {
    awaited: Vec<Check>,
    /// Until when results are waited for: nobody waits for a picture's footnote for long.
    until: Duration,
    found: BTreeMap<[String; 2], Difference>,
}

/// A tile that is rendered once more.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// By whom.
    pub worker: WorkerId,
    /// Which tile.
    pub tile: TileId,
    /// Under which attempt.
    pub attempt: Attempt,
    /// The classes that are compared, in order.
    pub classes: [String; 2],
}

impl Checks {
    /// Waits for `awaited` until `until`.
    pub fn new(awaited: Vec<Check>, until: Duration) -> Self {
        Self { awaited, until, found: BTreeMap::new() }
    }

    /// Whether nothing is waited for.
    pub fn is_over(&self) -> bool {
        self.awaited.is_empty()
    }

    /// When [`Checks::tick`] must be called at the latest.
    pub fn deadline(&self) -> Option<Duration> {
        (!self.is_over()).then_some(self.until)
    }

    /// Time has passed: late results are waited for no longer.
    pub fn tick(&mut self, now: Duration) {
        if self.until <= now {
            self.awaited.clear();
        }
    }

    /// `worker` is gone, and what it was asked for with it.
    pub fn lost(&mut self, worker: WorkerId) {
        self.awaited.retain(|check| check.worker != worker);
    }

    /// Where a result goes, if it is one that is waited for; each is taken once.
    pub fn take(&mut self, worker: WorkerId, tile: TileId, attempt: Attempt) -> Option<&mut Difference> {
        let is_it = |c: &Check| (c.worker, c.tile, c.attempt) == (worker, tile, attempt);
        let check = self.awaited.swap_remove(self.awaited.iter().position(is_it)?);
        Some(self.found.entry(check.classes).or_default())
    }

    /// What was found, by pairs of classes.
    pub fn into_found(self) -> impl Iterator<Item = ([String; 2], Difference)> {
        self.found.into_iter()
    }
}

/// Which of the tiles that came from each class are compared, spread over the image. Nothing but the arguments decides it.
pub fn choose<'a>(grid: &TileGrid, tiles: &BTreeMap<&'a str, Vec<TileId>>) -> Vec<(&'a str, TileId)> {
    let each = TILES.div_ceil(tiles.len().max(1));
    let mut chosen = Vec::new();
    for (&class, tiles) in tiles {
        // Along a curve that keeps neighbours together, so that steps of equal length lead to places far from each other.
        let mut tiles = tiles.clone();
        tiles.sort_by_key(|&tile| grid.rect(tile).map(|rect| interleave(rect.x, rect.y)));
        let count = each.min(tiles.len());
        chosen.extend((0..count).map(|i| (class, tiles[(2 * i + 1) * tiles.len() / (2 * count)])));
    }
    chosen
}

/// The place of a point on Morton's curve: its coordinates' bits, one after the other.
fn interleave(x: u32, y: u32) -> u64 {
    (0..u32::BITS).fold(0, |code, bit| {
        let pair = u64::from(x >> bit & 1) | u64::from(y >> bit & 1) << 1;
        code | pair << (2 * bit)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tessera_wire::PixelFormat;

    #[test]
    fn chosen_tiles_are_spread_and_every_class_has_one() {
        let grid = TileGrid::new(64, 64, 8).unwrap();
        let all: Vec<_> = (0..64).map(TileId).collect();
        let one = choose(&grid, &BTreeMap::from([("a", all.clone())]));
        // One in each quarter.
        let places: Vec<_> = one.iter().map(|&(_, tile)| grid.rect(tile).unwrap()).collect();
        let mut quarters: Vec<_> = places.iter().map(|r| (r.x / 32, r.y / 32)).collect();
        quarters.sort_unstable();
        assert_eq!(quarters, [(0, 0), (0, 1), (1, 0), (1, 1)]);
        let two = BTreeMap::from([("a", all[..63].to_vec()), ("b", all[63..].to_vec())]);
        let chosen: Vec<_> = choose(&grid, &two).into_iter().map(|(class, _)| class).collect();
        assert_eq!(chosen, ["a", "a", "b"]);
        let names: Vec<String> = (0..9).map(|i| format!("class {i}")).collect();
        let many = names.iter().zip(&all).map(|(name, &tile)| (name.as_str(), vec![tile])).collect();
        assert_eq!(choose(&grid, &many).len(), 9);
        assert_eq!(choose(&grid, &BTreeMap::new()), []);
    }

    #[test]
    fn results_are_taken_once_and_not_waited_for_for_ever() {
        let check = |worker, tile| Check {
            worker: WorkerId(worker),
            tile: TileId(tile),
            attempt: Attempt(1),
            classes: ["a".into(), "b".into()],
        };
        let second = Duration::from_secs(1);
        let mut checks = Checks::new(vec![check(0, 5), check(1, 6), check(2, 7)], second);
        assert_eq!(checks.deadline(), Some(second));
        assert!(checks.take(WorkerId(0), TileId(5), Attempt(0)).is_none(), "another attempt");
        checks.take(WorkerId(0), TileId(5), Attempt(1)).unwrap().add(PixelFormat::Rgba8, &[0; 8], &[0; 8]);
        assert!(checks.take(WorkerId(0), TileId(5), Attempt(1)).is_none(), "it was taken");
        checks.lost(WorkerId(1));
        checks.tick(second / 2);
        assert!(!checks.is_over());
        checks.tick(second);
        assert!(checks.is_over() && checks.deadline().is_none());
        let found: Vec<_> = checks.into_found().collect();
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].1.tiles, found[0].1.pixels), (1, 2));
    }
}
