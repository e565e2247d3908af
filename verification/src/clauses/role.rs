//! The role of a citation: code, or a kind of check.

use std::fmt;

/// The claim of a citation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// The code below implements the clause.
    Code,
    /// The code below fails when the clause is broken.
    Check(CheckKind),
    /// The program names the clause, in a log for example.
    Name,
}

/// The kind of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CheckKind {
    /// A unit, table or property test.
    Test,
    /// An explored state space.
    Model,
    /// A Kani proof.
    Kani,
    /// A loom model of atomics.
    Loom,
    /// A fuzz target.
    Fuzz,
    /// A golden vector.
    Vector,
    /// A test with real processes.
    Sys,
}

impl CheckKind {
    /// Every kind.
    pub const ALL: [Self; 7] = [
        Self::Test,
        Self::Model,
        Self::Kani,
        Self::Loom,
        Self::Fuzz,
        Self::Vector,
        Self::Sys,
    ];

    /// The words of all kinds, for messages.
    pub(super) const NAMES: &str = "test, model, kani, loom, fuzz, vector, sys";

    /// The word that ends a citation.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Test => "test",
            Self::Model => "model",
            Self::Kani => "kani",
            Self::Loom => "loom",
            Self::Fuzz => "fuzz",
            Self::Vector => "vector",
            Self::Sys => "sys",
        }
    }
}

impl fmt::Display for CheckKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}
