//! The cases, by what they are hard on. Their numbers are those of `tests/HARD_INPUTS.md`.

mod cameras;
mod cluster;
mod convergence;
mod degenerate;
mod hostile;
mod images;
mod leaks;
mod lights;
mod optics;
mod packing;
mod samplers;
mod stiff;
mod traversal;

use super::case::Case;

/// All of them, in the order of the report.
pub const ALL: &[&[Case]] = &[
    degenerate::CASES,
    traversal::CASES,
    leaks::CASES,
    packing::CASES,
    images::CASES,
    lights::CASES,
    optics::CASES,
    cameras::CASES,
    hostile::CASES,
    cluster::CASES,
    stiff::CASES,
    convergence::CASES,
    samplers::CASES,
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_case_has_an_id_of_its_own() {
        let ids: Vec<_> = ALL.iter().copied().flatten().map(|case| case.id).collect();
        assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), ids.len(), "{ids:?}");
    }

    /// 44 is about rooms that are not built.
    #[test]
    fn every_number_of_the_list_has_a_case() {
        let numbers: BTreeSet<u32> = ALL
            .iter()
            .copied()
            .flatten()
            .filter_map(|case| case.id.split('-').next()?.parse().ok())
            .collect();
        let missing: Vec<_> = (1..=43).filter(|number| !numbers.contains(number)).collect();
        assert!(missing.is_empty(), "no case for {missing:?}");
    }
}
