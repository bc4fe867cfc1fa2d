//! Lists of tiles that are dealt in advance, by what tiles cost and how fast workers are.

use std::{cmp::Reverse, collections::BinaryHeap};
use tessera_wire::TileId;

/// Deals tiles so that worker `i`, who does `speeds[i]` seconds of work a second, ends at about the same time as the others, later by
/// `later[i]` seconds.
///
/// The longest tile first, to whoever would be ready with it first (Graham 1969): the last to end is late by less than the shortest
/// tile that it was dealt. Each list begins with its longest tiles, so that the last one, which may go to another in the end, is short.
pub fn deal_by_cost(costs: &[f32], speeds: &[f64], later: &[f64]) -> Vec<Vec<TileId>> {
    let mut lists = vec![Vec::new(); speeds.len()];
    if speeds.is_empty() {
        return lists;
    }
    let mut tiles: Vec<_> = (0..costs.len()).collect();
    tiles.sort_by(|&a, &b| costs[b].total_cmp(&costs[a]).then(a.cmp(&b)));
    // When each worker has done what it was dealt, before the time by which it may be later.
    let ready = |i: usize| Ready { at: -later.get(i).copied().unwrap_or(0.0), worker: i };
    let mut heap: BinaryHeap<_> = (0..speeds.len()).map(|i| Reverse(ready(i))).collect();
    let mut looked_at = Vec::new();
    for tile in tiles {
        let cost = f64::from(costs[tile]).max(0.0);
        // Of those that are ready first, who would end first with it: not the first of all if that one is slow.
        looked_at.extend((0..CANDIDATES).map_while(|_| heap.pop()).map(|Reverse(ready)| ready));
        let ends = |ready: &Ready| ready.at + cost / speeds[ready.worker];
        let best = (0..looked_at.len()).min_by(|&a, &b| ends(&looked_at[a]).total_cmp(&ends(&looked_at[b])));
        if let Some(best) = best {
            looked_at[best].at = ends(&looked_at[best]);
            lists[looked_at[best].worker].push(TileId(tile as u32));
        }
        heap.extend(looked_at.drain(..).map(Reverse));
    }
    lists
}

/// Workers that are asked for each tile: enough to find one that is not slow among those that have least to do.
const CANDIDATES: usize = 8;

/// By how much later than the first each of `workers` should end, so that a link that all share takes `batch` seconds of each in turn
/// (algorithms C.5: finish times staggered by b). At most `spread` in all, the time that they have.
pub fn staggered(workers: usize, batch: f64, spread: f64) -> Vec<f64> {
    let step = batch.min(spread / workers.max(2).saturating_sub(1) as f64);
    (0..workers).map(|i| i as f64 * step).collect()
}

/// Cuts `tiles` into `count` pieces that differ by one in length at most.
pub fn pieces(tiles: &[TileId], count: usize) -> Vec<Vec<TileId>> {
    let end = |i: usize| i * tiles.len() / count.max(1);
    (0..count).map(|i| tiles[end(i)..end(i + 1)].to_vec()).collect()
}

/// A worker and when it is ready.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ready {
    at: f64,
    worker: usize,
}

impl Eq for Ready {}

impl PartialOrd for Ready {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Ready {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.at.total_cmp(&other.at).then(self.worker.cmp(&other.worker))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loads(costs: &[f32], speeds: &[f64], later: &[f64]) -> Vec<f64> {
        let lists = deal_by_cost(costs, speeds, later);
        assert_eq!(lists.iter().map(Vec::len).sum::<usize>(), costs.len());
        let load = |list: &Vec<TileId>| list.iter().map(|t| f64::from(costs[t.0 as usize])).sum::<f64>();
        lists.iter().map(load).zip(speeds).map(|(load, speed)| load / speed).collect()
    }

    #[test]
    fn all_end_at_about_the_same_time() {
        let costs: Vec<f32> = (0..256u32).map(|i| (1 + i * 7919 % 31) as f32 / 1000.0).collect();
        let total: f64 = costs.iter().map(|c| f64::from(*c)).sum();
        for speeds in [vec![1.0; 16], (0..16).map(|i| 0.4 + 0.08 * f64::from(i)).collect(), vec![1.0, 0.1]] {
            let ideal = total / speeds.iter().sum::<f64>();
            for load in loads(&costs, &speeds, &[]) {
                // The shortest tile, a millisecond, on the slowest.
                assert!((load - ideal).abs() < 0.001 / 0.1, "{load} of {ideal}");
            }
        }
        // More workers than tiles, and tiles that cost nothing.
        assert_eq!(deal_by_cost(&[1.0], &[1.0; 3], &[]).iter().map(Vec::len).max(), Some(1));
        assert_eq!(deal_by_cost(&[0.0; 5], &[1.0; 2], &[]).iter().map(Vec::len).sum::<usize>(), 5);
        assert_eq!(deal_by_cost(&[1.0], &[], &[]), Vec::<Vec<TileId>>::new());
    }

    #[test]
    fn workers_end_one_after_the_other_where_they_are_to() {
        let costs = vec![0.001f32; 1600];
        let later = staggered(16, 0.01, 1.0);
        let loads = loads(&costs, &[1.0; 16], &later);
        for pair in loads.windows(2) {
            assert!((pair[1] - pair[0] - 0.01).abs() < 0.0021, "{loads:?}");
        }
        // A batch that takes longer than there is time for is not waited for.
        assert_eq!(staggered(3, 10.0, 1.0), [0.0, 0.5, 1.0]);
        assert_eq!(staggered(1, 10.0, 1.0), [0.0]);
    }

    #[test]
    fn pieces_are_equal_and_complete() {
        let tiles: Vec<_> = (0..64).map(TileId).collect();
        for count in [1, 3, 16, 100] {
            let pieces = pieces(&tiles, count);
            assert_eq!(pieces.concat(), tiles);
            let lengths = pieces.iter().map(Vec::len);
            assert!(lengths.clone().max().unwrap() - lengths.min().unwrap() <= 1);
        }
    }
}
