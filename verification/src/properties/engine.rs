//! The engines, and their names in PROPERTIES.md and in results.

use std::fmt;

/// A program that runs checks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Engine {
    /// The citations of SPEC.md.
    Clauses,
    /// A library of `sm2-proto` that is linked without std.
    NoStd,
    /// The Kani harnesses, by enumeration and samples.
    StandIn,
    /// Tests.
    Test,
    /// Tests with random sequences of operations.
    Proptest,
    /// Tests that replay golden vectors.
    Vector,
    /// All executions of threads, within bounds.
    Loom,
    /// All orders of events, within bounds.
    Model,
    /// Symbolic execution of the compiled harnesses.
    Angr,
    /// Fuzzing.
    LibFuzzer,
    /// Faults in the code that a check must find.
    Mutants,
    /// The Kani harnesses, as proofs.
    Kani,
}

impl Engine {
    /// All engines, in the order in which they run: quick ones first.
    pub const ALL: [Self; 12] = [
        Self::Clauses,
        Self::NoStd,
        Self::StandIn,
        Self::Vector,
        Self::Test,
        Self::Proptest,
        Self::Loom,
        Self::Model,
        Self::Angr,
        Self::LibFuzzer,
        Self::Mutants,
        Self::Kani,
    ];

    /// The name of the engine.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Clauses => "clauses",
            Self::NoStd => "no-std",
            Self::StandIn => "stand-in",
            Self::Test => "test",
            Self::Proptest => "proptest",
            Self::Vector => "vector",
            Self::Loom => "loom",
            Self::Model => "model",
            Self::Angr => "angr",
            Self::LibFuzzer => "libFuzzer",
            Self::Mutants => "mutants",
            Self::Kani => "kani",
        }
    }

    /// The engine of this name.
    #[must_use]
    pub fn named(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|it| it.word() == word)
    }
}

impl fmt::Display for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}
