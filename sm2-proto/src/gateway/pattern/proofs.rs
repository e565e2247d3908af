//! Harness for patterns, over two segments that differ.

use super::{Part, fits};
use crate::proofs::{below, one_of};

/// What a pattern stands for, said once more.
fn stands_for(pattern: &[Part<u8>], name: &[u8]) -> bool {
    match (pattern, name) {
        ([], name) => name.is_empty(),
        ([Part::AnyNumber, behind @ ..], name) => {
            (0..=name.len()).any(|taken| stands_for(behind, &name[taken..]))
        }
        ([Part::AnyOne, behind @ ..], [_, rest @ ..]) => stands_for(behind, rest),
        ([Part::Only(ours), behind @ ..], [its, rest @ ..]) => {
            ours == its && stands_for(behind, rest)
        }
        _ => false,
    }
}

/// Three parts and four segments at most.
//= SM2-GWR-001 kani
#[cfg_attr(kani, kani::proof)]
// A name of four segments, taken by three parts one more each time.
#[cfg_attr(kani, kani::unwind(24))]
fn a_pattern_fits_what_it_stands_for() {
    const PARTS: [Part<u8>; 4] = [Part::Only(0), Part::Only(1), Part::AnyOne, Part::AnyNumber];
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
        "`**` takes several"
    );
    kani::cover!(!fitted && segments == parts, "it is about others");
}

#[cfg(test)]
kani::explored! {
    a_pattern_fits_what_it_stands_for: 2,
}
