//! A proof about patterns, over names of two different segments.

use super::{Part, fits};
use crate::proofs::{below, one_of};

/// The definition of SM2-GWR-001, written as a recursion: the oracle of the proof.
fn stands_for(pattern: &[Part<u8>], name: &[u8]) -> bool {
    match (pattern, name) {
        ([], name) => name.is_empty(),
        ([Part::AnyNumber, behind @ ..], name) => {
            (0..=name.len()).any(|taken| stands_for(behind, &name[taken..]))
        }
        ([Part::AnyOne, behind @ ..], [_, rest @ ..]) => stands_for(behind, rest),
        ([Part::Exact(expected), behind @ ..], [segment, rest @ ..]) => {
            expected == segment && stands_for(behind, rest)
        }
        _ => false,
    }
}

/// The loop and the oracle agree on every pattern of up to three parts and name of up to four
/// segments.
//= SM2-GWR-001 kani
// Shows GW-RULE (Exhaustive), bound: patterns of up to three parts, names of up to four segments, of two that differ.
#[cfg_attr(kani, kani::proof)]
// Three parts that each take one of four segments more at a time.
#[cfg_attr(kani, kani::unwind(24))]
fn a_pattern_fits_what_it_stands_for() {
    const PARTS: [Part<u8>; 4] = [
        Part::Exact(0),
        Part::Exact(1),
        Part::AnyOne,
        Part::AnyNumber,
    ];
    let parts = below(4);
    let pattern = [one_of(&PARTS), one_of(&PARTS), one_of(&PARTS)];
    let segments = below(5);
    let name = [
        below(2) as u8,
        below(2) as u8,
        below(2) as u8,
        below(2) as u8,
    ];
    let (pattern, name) = (&pattern[..parts], &name[..segments]);
    let expected = stands_for(pattern, name);
    let fitted = fits(pattern.iter().copied(), name.iter().copied());
    assert_eq!(fitted, expected);
    kani::cover!(
        fitted && pattern.contains(&Part::AnyNumber) && segments > parts,
        "`**` takes several segments"
    );
    kani::cover!(!fitted && segments == parts, "the pattern does not match");
}

#[cfg(test)]
kani::explored! {
    a_pattern_fits_what_it_stands_for: 2,
}
