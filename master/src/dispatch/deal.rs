//! Tiles given out in advance.

use tessera_wire::{TileGrid, TileId};

/// Owner of `tile` in row-by-row round robin (Seo, Park, Ihm 2022): `tile mod workers`. When `workers`
/// divides the columns, every worker gets whole columns of the image.
pub fn row_major_owner(tile: TileId, workers: u32) -> u32 {
    tile.0 % workers
}

/// A deal without stripes: tile (column, row) belongs to worker `(column + k row) mod S`.
///
/// With k coprime to S, any S neighbours in a row **or a column** have S different owners: in every row and
/// every column the loads differ by at most one tile. Over the image they differ by at most `min(columns mod
/// S, rows mod S)`, because whole blocks of S columns or S rows are shared out evenly. Among such k the one
/// with the most even loads is taken, and of those the one next to the golden section of S, whose lattice
/// keeps a worker's tiles farthest apart (k = 1 and k = S - 1 are diagonals, avoided where there is another).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Deal {
    columns: u32,
    workers: u32,
    multiplier: u32,
}

impl Deal {
    /// The deal of `grid` to `workers`, >= 1.
    pub fn new(grid: &TileGrid, workers: u32) -> Self {
        let (columns, rows) = (grid.columns(), grid.rows());
        let is_diagonal = |k: u32| k == 1 || k == workers - 1;
        let multiplier = (1..workers)
            .filter(|&k| gcd(k, workers) == 1)
            .min_by_key(|&k| {
                let off_golden = (1000 * u64::from(k)).abs_diff(618 * u64::from(workers));
                (is_diagonal(k), spread(columns % workers, rows % workers, workers, k), off_golden)
            })
            .unwrap_or(1);
        Self { columns, workers, multiplier }
    }

    /// Owner of `tile`, below the number of workers.
    pub fn owner(&self, tile: TileId) -> u32 {
        let (column, row) = (tile.0 % self.columns, tile.0 / self.columns);
        // No overflow: fewer than 2^16 rows, and a multiplier below the number of workers, taken mod it
        // first.
        let workers = u64::from(self.workers);
        ((u64::from(column) + u64::from(self.multiplier) * u64::from(row)) % workers) as u32
    }
}

/// Most minus fewest tiles of a worker in a block of `columns` x `rows`, both below `workers`.
fn spread(columns: u32, rows: u32, workers: u32, multiplier: u32) -> u32 {
    let mut loads = vec![0u32; workers as usize];
    for row in 0..rows {
        for column in 0..columns {
            loads[((column + multiplier * row) % workers) as usize] += 1;
        }
    }
    let most = loads.iter().max().copied().unwrap_or(0);
    most - loads.iter().min().copied().unwrap_or(0)
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Loads per worker over the tiles that `keep` lets through.
    fn loads(grid: &TileGrid, workers: u32, keep: impl Fn(u32, u32) -> bool) -> Vec<u32> {
        let deal = Deal::new(grid, workers);
        let mut loads = vec![0; workers as usize];
        for id in 0..grid.tiles() {
            if keep(id % grid.columns(), id / grid.columns()) {
                loads[deal.owner(TileId(id)) as usize] += 1;
            }
        }
        loads
    }

    fn spread_of(loads: &[u32]) -> u32 {
        loads.iter().max().unwrap() - loads.iter().min().unwrap()
    }

    #[test]
    fn no_worker_gets_a_stripe_and_loads_are_even() {
        for workers in 2..=16 {
            for (columns, rows) in [(8, 8), (4, 4), (16, 16), (32, 32), (15, 9), (30, 17), (60, 34), (7, 5)] {
                let grid = TileGrid::new(columns * 8, rows * 8, 8).unwrap();
                for c in 0..columns {
                    assert!(spread_of(&loads(&grid, workers, |column, _| column == c)) <= 1);
                }
                for r in 0..rows {
                    assert!(spread_of(&loads(&grid, workers, |_, row| row == r)) <= 1);
                }
                let all = loads(&grid, workers, |_, _| true);
                assert!(spread_of(&all) <= 3, "{columns} x {rows} to {workers}: {all:?}");
            }
        }
    }

    #[test]
    fn one_worker_and_more_workers_than_tiles() {
        let grid = TileGrid::new(16, 16, 8).unwrap();
        assert_eq!(loads(&grid, 1, |_, _| true), [4]);
        let many = loads(&grid, 300, |_, _| true);
        assert_eq!(many.iter().sum::<u32>(), 4);
        assert_eq!(many.iter().max(), Some(&1));
        // One row, one column: plain round robin.
        let row = TileGrid::new(20_000, 1, 32).unwrap();
        assert!(spread_of(&loads(&row, 7, |_, _| true)) <= 1);
    }

    #[test]
    fn the_paper_s_round_robin_gives_columns() {
        // 64 tiles in 8 columns to 8 workers, as in the paper's measurements.
        for id in 0..64 {
            assert_eq!(row_major_owner(TileId(id), 8), id % 8);
        }
    }
}
