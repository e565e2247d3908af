//! Names that a person may have meant to be the same.
//!
//! This rule compares the segments of names, too, which a crate for edit distances does not.

use serde::Serialize;
use sm2_proto::Name;

/// How two different names look alike: the first that applies, in this order, because
/// the likelier mistake comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NearName {
    /// They differ in upper and lower case only.
    Case,
    /// One character is missing, too many or another, or two neighbours are swapped.
    Edit,
    /// One name is the other without some segments: `scan` and `front/scan`.
    Segments,
    /// All segments but the last are equal: `front/scan` and `front/image`.
    Leading,
}

/// How the two look alike, if they differ and look alike.
pub(super) fn near(one: &Name, other: &Name) -> Option<NearName> {
    let (one, other) = (one.as_str(), other.as_str());
    if one == other {
        None
    } else if one.eq_ignore_ascii_case(other) {
        Some(NearName::Case)
    } else if one_edit(one.as_bytes(), other.as_bytes()) {
        Some(NearName::Edit)
    } else if without_segments(one, other) || without_segments(other, one) {
        Some(NearName::Segments)
    } else if one.contains('/') && leading(one) == leading(other) {
        Some(NearName::Leading)
    } else {
        None
    }
}

fn one_edit(one: &[u8], other: &[u8]) -> bool {
    let same = |(a, b): &(&u8, &u8)| a == b;
    let front = one.iter().zip(other).take_while(same).count();
    let (one, other) = (&one[front..], &other[front..]);
    let back = one.iter().rev().zip(other.iter().rev());
    let back = back.take_while(same).count();
    let (one, other) = (&one[..one.len() - back], &other[..other.len() - back]);
    match (one, other) {
        ([], [_]) | ([_], [] | [_]) => true,
        (&[a, b], &[c, d]) => (a, b) == (d, c),
        _ => false,
    }
}

/// Whether the shorter name is the longer one without some adjacent segments, the last one not
/// among them.
fn without_segments(longer: &str, shorter: &str) -> bool {
    let (mut longer, mut shorter) = (longer.split('/'), shorter.split('/'));
    let mut last = None;
    // Compares from the front as far as both agree, then the rest of the shorter one from the back.
    let rest = loop {
        let Some(segment) = shorter.next() else {
            break None;
        };
        if longer.next() != Some(segment) {
            break Some(segment);
        }
        last = Some(segment);
    };
    match rest {
        // If the whole shorter name stands in front, its last segment has to be the last of both.
        None => longer.next_back().is_some_and(|it| Some(it) == last),
        Some(first) => {
            let mut left = std::iter::once(first).chain(shorter);
            loop {
                match (left.next_back(), longer.next_back()) {
                    (None, _) => break true,
                    (Some(ours), Some(theirs)) if ours == theirs => {}
                    _ => break false,
                }
            }
        }
    }
}

fn leading(name: &str) -> Option<&str> {
    name.rsplit_once('/').map(|(leading, _)| leading)
}
