//! Patterns of names: SPEC section 14.6.

#[cfg(any(kani, test))]
mod proofs;

use alloc::{borrow::ToOwned, string::String};
use core::{fmt, str::FromStr};

use crate::{Name, NameError, limits::NAME_MAX};

/// A pattern of names: segments joined by `/`. `*` matches exactly one segment of a name, `**` any
/// number of segments, and every other segment matches itself.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Pattern(String);

/// The reason why a text is not a [`Pattern`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PatternError {
    /// The text is longer than the longest name.
    #[error("a pattern has at most {NAME_MAX} bytes, this one has {0}")]
    TooLong(usize),
    /// A segment is neither `*` nor `**` nor a legal segment of a name.
    #[error("segment {index} of the pattern is neither `*` nor `**`, and {error}")]
    BadSegment {
        /// The number of the segment, counted from 1.
        index: usize,
        /// Why the segment is not legal in a name.
        error: NameError,
    },
}

/// A segment of a pattern.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part<T> {
    /// This segment of a name.
    Exact(T),
    /// `*`
    AnyOne,
    /// `**`
    AnyNumber,
}

impl Pattern {
    /// Checks that `text` is a pattern.
    ///
    /// # Errors
    /// The text is too long, or one of its segments is not legal.
    pub fn new(text: &str) -> Result<Self, PatternError> {
        if text.len() > NAME_MAX {
            return Err(PatternError::TooLong(text.len()));
        }
        for (index, part) in (1..).zip(parts(text)) {
            if let Part::Exact(segment) = part {
                Name::new(segment).map_err(|error| PatternError::BadSegment { index, error })?;
            }
        }
        Ok(Self(text.to_owned()))
    }

    /// Whether the pattern matches this name.
    #[must_use]
    pub fn fits(&self, name: &Name) -> bool {
        fits(parts(&self.0), name.as_str().split('/'))
    }

    /// The text of the pattern.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

fn parts(text: &str) -> impl Iterator<Item = Part<&str>> + Clone {
    text.split('/').map(|segment| match segment {
        "*" => Part::AnyOne,
        "**" => Part::AnyNumber,
        _ => Part::Exact(segment),
    })
}

/// Matches greedily with one point to return to. Each `**` takes no segment at first. On a mismatch,
/// the latest `**` takes one segment more, and matching continues behind it. Earlier `**` need no
/// second try: the parts before the latest `**` match already, and it can take any segment that an
/// earlier `**` could.
//= SM2-GWR-001
fn fits<T: PartialEq>(
    mut pattern: impl Iterator<Item = Part<T>> + Clone,
    mut name: impl Iterator<Item = T> + Clone,
) -> bool {
    // The parts behind the latest `**`, and the segments that it has not taken.
    let mut latest = None;
    loop {
        let (mut parts, mut segments) = (pattern.clone(), name.clone());
        let matches = match (parts.next(), segments.next()) {
            (None, None) => return true,
            (Some(Part::AnyNumber), _) => {
                latest = Some((parts.clone(), name.clone()));
                pattern = parts;
                continue;
            }
            (Some(Part::AnyOne), Some(_)) => true,
            (Some(Part::Exact(expected)), Some(segment)) => expected == segment,
            _ => false,
        };
        if matches {
            (pattern, name) = (parts, segments);
            continue;
        }
        let Some((behind, rest)) = &mut latest else {
            return false;
        };
        if rest.next().is_none() {
            return false;
        }
        (pattern, name) = (behind.clone(), rest.clone());
    }
}

impl fmt::Display for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for Pattern {
    type Err = PatternError;

    fn from_str(text: &str) -> Result<Self, PatternError> {
        Self::new(text)
    }
}
