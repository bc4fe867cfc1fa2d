//! A curve through all tiles that keeps neighbours together.

use tessera_wire::{TileGrid, TileId};

/// The tiles of `grid` along Hilbert's curve (Hilbert 1891) through the least square of a power of two that covers it.
pub fn hilbert_order(grid: &TileGrid) -> Vec<TileId> {
    let side = grid.columns().max(grid.rows()).next_power_of_two();
    let place = |tile: TileId| index(side, tile.0 % grid.columns(), tile.0 / grid.columns());
    let mut tiles: Vec<_> = (0..grid.tiles()).map(TileId).collect();
    tiles.sort_by_cached_key(|&tile| place(tile));
    tiles
}

/// How far along the curve through a square of `side`, a power of two, column `x` of row `y` is.
fn index(side: u32, mut x: u32, mut y: u32) -> u64 {
    let mut along = 0;
    let mut half = side / 2;
    while half > 0 {
        let (right, below) = (u32::from(x & half > 0), u32::from(y & half > 0));
        along += u64::from(half) * u64::from(half) * u64::from((3 * right) ^ below);
        // Turn the quarter so that the curve through it begins where the one before has ended.
        if below == 0 {
            if right == 1 {
                (x, y) = (side - 1 - x, side - 1 - y);
            }
            (x, y) = (y, x);
        }
        half /= 2;
    }
    along
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_tile_comes_once_and_next_to_the_one_before() {
        for side in [1, 2, 4, 8, 32] {
            let grid = TileGrid::new(8 * side, 8 * side, 8).unwrap();
            let order = hilbert_order(&grid);
            let mut all = order.clone();
            all.sort_unstable();
            assert!(all.into_iter().eq((0..side * side).map(TileId)));
            for pair in order.windows(2) {
                let place = |tile: TileId| (tile.0 % side, tile.0 / side);
                let ((x, y), (a, b)) = (place(pair[0]), place(pair[1]));
                assert_eq!(x.abs_diff(a) + y.abs_diff(b), 1, "{pair:?} of {side}");
            }
        }
        let grid = TileGrid::new(70, 20, 8).unwrap();
        let mut all = hilbert_order(&grid);
        all.sort_unstable();
        assert!(all.into_iter().eq((0..grid.tiles()).map(TileId)));
    }
}
