//! Which triangles of an input can be used at all.

/// What [`clean`] kept and why it dropped the rest.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cleaned {
    /// Indices of the triangles that are kept, ascending.
    pub kept: Vec<u32>,
    /// Triangles with an index that is not below the number of vertices.
    pub index_out_of_range: u64,
    /// Triangles that touch a vertex with a NaN or infinite coordinate.
    pub not_finite: u64,
    /// Triangles that name one vertex twice.
    pub repeated_index: u64,
}

/// Sorts out triangles that cannot be used: first by index, then by coordinate, then by repetition; each triangle is counted
/// once, under the first fault found. Vertices are not touched: those that no kept triangle uses must not widen the box.
pub fn clean(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Cleaned {
    let mut out = Cleaned { kept: Vec::with_capacity(triangles.len()), ..Cleaned::default() };
    for (id, &[a, b, c]) in triangles.iter().enumerate() {
        let corners = [a, b, c].map(|v| positions.get(v as usize));
        if corners.iter().any(Option::is_none) {
            out.index_out_of_range += 1;
        } else if corners.iter().flatten().any(|p| p.iter().any(|x| !x.is_finite())) {
            out.not_finite += 1;
        } else if a == b || b == c || c == a {
            out.repeated_index += 1;
        } else {
            out.kept.push(id as u32);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_is_counted_once_and_the_rest_is_kept() {
        let positions =
            [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [f64::NAN, 0.0, 0.0], [0.0, f64::INFINITY, 0.0]];
        let triangles =
            [[0, 1, 2], [0, 1, 5], [3, 3, 9], [0, 1, 3], [4, 4, 1], [2, 1, 2], [2, 1, 0], [u32::MAX, 0, 1]];
        let cleaned = clean(&positions, &triangles);
        assert_eq!(cleaned.kept, [0, 6]);
        assert_eq!(
            (cleaned.index_out_of_range, cleaned.not_finite, cleaned.repeated_index),
            (3, 2, 1),
            "{cleaned:?}"
        );
        assert_eq!(clean(&positions, &[]), Cleaned::default());
    }
}
