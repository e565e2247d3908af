//! What has to hold, and how a breach of it is told.

use std::fmt;

/// What is checked, with the clauses that ask for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Property {
    /// `MGR-STRICT`: a correct Manager hangs up on no correct node (SM2-SES-005).
    ManagerAccusesNobody,
    /// `CLI-NOFALSE`: a correct node accuses no correct Manager (SM2-NOD-001).
    NodeAccusesNobody,
    /// `MGR-MATCH`: no pair has two links that both ends regard as live (SM2-MAT-002).
    OneLinkPerPair,
    /// `MGR-IDS`: ids of links are never used again (SM2-LNK-002).
    FreshIds,
    /// `LNK-FAREWELL`: one farewell per end and direction of a session (SM2-LNK-003).
    OneFarewell,
    /// `CLI-SURVIVE`: a link that nobody had reason to end is not ended, and keeps its id
    /// across a take-over (SM2-NOD-003, SM2-RES-004).
    LinksSurvive,
    /// `CLI-CONVERGE`: once all is quiet links are what matching says, on both sides, and
    /// quiet comes about (SM2-MAT-002, SM2-RES-002, SM2-RES-007).
    Converges,
    /// `MGR-MIRROR`: pages show what there is (SM2-IFC-007).
    MirrorIsExact,
    /// `MGR-TOTAL`, `MGR-INV`: no machine panics; with debug assertions the Manager's tables
    /// agree after each input.
    Invariants,
}

/// A property that does not hold.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Failure {
    /// Which.
    pub property: Property,
    /// What was seen.
    pub what: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: {}", self.property, self.what)
    }
}
