//! Parts of texts for people, shared by all crates.

use core::fmt;

/// A count with its noun: `1 node`, `2 nodes`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counted<'a> {
    count: u64,
    noun: &'a str,
}

impl<'a> Counted<'a> {
    /// Takes the noun in the singular. Its plural must end in `s`.
    #[must_use]
    pub const fn new(count: u64, noun: &'a str) -> Self {
        Self { count, noun }
    }
}

impl fmt::Display for Counted<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { count, noun } = self;
        let plural = if *count == 1 { "" } else { "s" };
        write!(f, "{count} {noun}{plural}")
    }
}

#[cfg(test)]
mod tests {
    use alloc::string::ToString as _;

    use super::Counted;

    #[test]
    fn only_one_is_singular() {
        for (count, expected) in [(0, "0 nodes"), (1, "1 node"), (2, "2 nodes")] {
            assert_eq!(Counted::new(count, "node").to_string(), expected);
        }
    }
}
