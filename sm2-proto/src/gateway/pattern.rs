//! Patterns of names: SPEC section 14.6.

#[cfg(any(kani, test))]
mod proofs;

use alloc::{borrow::ToOwned, string::String};
use core::{fmt, str::FromStr};

use crate::{Name, NameError, limits::NAME_MAX};

/// Segments joined by `/`: those of a name, `*` for any one, `**` for any number of them.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Pattern(String);

/// Why a text is not a [`Pattern`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PatternError {
    /// The text is longer than a name can be.
    #[error("a pattern is at most {NAME_MAX} bytes, this one has {0}")]
    TooLong(usize),
    /// A segment is neither `*` nor `**` nor one of a name.
    #[error("segment {index} of the pattern is not `*` nor `**`, and {error}")]
    BadSegment {
        /// Which, from 1.
        index: usize,
        /// What is wrong with it, as a name.
        error: NameError,
    },
}

/// A segment of a pattern.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part<T> {
    Only(T),
    AnyOne,
    AnyNumber,
}

impl Pattern {
    /// Checks `text`, as it stands.
    ///
    /// # Errors
    /// It is no pattern.
    pub fn new(text: &str) -> Result<Self, PatternError> {
        if text.len() > NAME_MAX {
            return Err(PatternError::TooLong(text.len()));
        }
        for (index, part) in (1..).zip(parts(text)) {
            if let Part::Only(segment) = part {
                Name::new(segment).map_err(|error| PatternError::BadSegment { index, error })?;
            }
        }
        Ok(Self(text.to_owned()))
    }

    /// Whether it stands for this name.
    #[must_use]
    pub fn fits(&self, name: &Name) -> bool {
        fits(parts(&self.0), name.as_str().split('/'))
    }

    /// The pattern's text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

fn parts(text: &str) -> impl Iterator<Item = Part<&str>> + Clone {
    text.split('/').map(|segment| match segment {
        "*" => Part::AnyOne,
        "**" => Part::AnyNumber,
        _ => Part::Only(segment),
    })
}

/// Takes the shortest way for each `**`, and one segment more for the last of them where that
/// leads nowhere: what stands before it fits already, so no other can do better.
//= SM2-GWR-001
fn fits<T: PartialEq>(
    mut pattern: impl Iterator<Item = Part<T>> + Clone,
    mut name: impl Iterator<Item = T> + Clone,
) -> bool {
    // What is behind the last `**`, and what that has not taken.
    let mut last = None;
    loop {
        let (mut parts, mut segments) = (pattern.clone(), name.clone());
        let is_one = match (parts.next(), segments.next()) {
            (None, None) => return true,
            (Some(Part::AnyNumber), _) => {
                last = Some((parts.clone(), name.clone()));
                pattern = parts;
                continue;
            }
            (Some(Part::AnyOne), Some(_)) => true,
            (Some(Part::Only(ours)), Some(its)) => ours == its,
            _ => false,
        };
        if is_one {
            (pattern, name) = (parts, segments);
            continue;
        }
        let Some((behind, rest)) = &mut last else {
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
