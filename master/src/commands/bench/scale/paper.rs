//! The paper's figures (Seo, Park, Ihm 2022), to stand beside ours.

/// Numbers of workers of Table 9.
pub const WORKERS: [usize; 5] = [1, 2, 4, 8, 16];

/// Milliseconds of a frame by scene, with the static and the dynamic scheme (Table 9; tiles of 128).
pub const TABLE_9: [(&str, [f64; 5], [f64; 5]); 4] = [
    ("Sponza", [2905.4, 1680.9, 896.4, 546.5, 380.6], [2763.2, 1526.9, 892.9, 682.4, 621.7]),
    ("Soda Hall", [3224.5, 1621.2, 876.9, 553.1, 347.8], [3184.5, 1711.2, 937.2, 720.8, 698.7]),
    ("San Miguel", [6128.5, 3283.8, 1828.7, 1145.3, 647.5], [5129.6, 2883.7, 1658.9, 1293.2, 1077.3]),
    ("Power Plant", [3862.6, 2218.0, 1364.9, 704.6, 393.8], [3218.5, 1799.4, 951.3, 759.5, 724.1]),
];

/// Sides of tiles of Table 8.
pub const SIDES: [u32; 4] = [256, 128, 64, 32];

/// Milliseconds of a frame by scene and side of a tile, static scheme: of one worker and of 16 (Table 8).
pub const TABLE_8: [(&str, [f64; 4], [f64; 4]); 4] = [
    ("Sponza", [3030.6, 2905.4, 3903.6, 5754.2], [374.4, 380.6, 396.6, 522.7]),
    ("Soda Hall", [3107.8, 3224.5, 3839.0, 5639.8], [368.6, 347.8, 408.2, 563.5]),
    ("San Miguel", [6208.7, 6128.5, 6744.9, 8162.8], [678.1, 647.5, 660.6, 698.7]),
    ("Power Plant", [3939.7, 3862.6, 4682.2, 6845.1], [427.4, 393.8, 459.0, 689.8]),
];

/// A scene of Table 7: of one worker, of sixteen.
type Compressed = (&'static str, [f64; 4], [Option<f64>; 4]);

/// What is compressed in Table 7.
pub const COMPRESSED: [&str; 4] = ["nothing", "mesh", "tree", "both"];

/// Milliseconds of a frame of one worker and of 16, by [`COMPRESSED`] (Table 7); what is not known
/// there is `None`.
pub const TABLE_7: [Compressed; 2] = [
    ("Sponza", [2632.4, 2832.2, 2776.6, 2905.4], [Some(358.1), None, None, Some(380.6)]),
    ("Soda Hall", [2788.1, 2893.4, 2936.9, 3224.5], [Some(321.5), None, None, Some(347.8)]),
];
