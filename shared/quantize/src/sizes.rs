//! The paper's size formulas (Seo, Park, Ihm 2022, section 3.1 and tables 1 and 3), for reports beside the sizes in fact.

/// Bytes of the cell table (65,536 cells of 3 x 16 bits) and the normal table (65,536 normals of 3 x 32 bits).
const TABLES: u64 = 18 << 16;

/// Bytes of an unquantised mesh: `32 nv + 12 nf + 8` (positions, normals and texture coordinates in `f32`; table 1).
pub const fn plain_mesh(vertices: u64, triangles: u64) -> u64 {
    32 * vertices + 12 * triangles + 8
}

/// Bytes of a quantised mesh with its tables: `12 nv + 12 nf + 18 * 2^16 + 24` (the formula of section 3.1).
pub const fn quantised_mesh(vertices: u64, triangles: u64) -> u64 {
    quantised_mesh_without_tables(vertices, triangles) + TABLES + 24
}

/// Bytes of a quantised mesh as table 3 prints them: without the tables and the header.
pub const fn quantised_mesh_without_tables(vertices: u64, triangles: u64) -> u64 {
    12 * vertices + 12 * triangles
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Vertices, triangles, then the MiB printed in tables 1 and 3.
    const TABLE: [(&str, u64, u64, f64, f64); 4] = [
        ("Sponza", 193_372, 279_163, 9.1, 5.4),
        ("Soda Hall", 4_192_793, 2_167_474, 152.8, 72.8),
        ("San Miguel", 9_278_776, 9_963_191, 397.2, 220.2),
        ("Power Plant", 10_960_555, 12_748_510, 480.4, 271.3),
    ];

    #[test]
    fn the_printed_sizes_come_out() {
        for (name, nv, nf, plain, quantised) in TABLE {
            let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
            assert!((mib(plain_mesh(nv, nf)) - plain).abs() <= 0.05, "{name}");
            assert!((mib(quantised_mesh_without_tables(nv, nf)) - quantised).abs() <= 0.05, "{name}");
        }
        assert_eq!(quantised_mesh(0, 0), 1_179_648 + 24);
    }
}
