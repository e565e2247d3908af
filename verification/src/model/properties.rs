//! The checked properties, and the report of a broken one.

use std::fmt;

/// A checked property, with the clauses that require it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
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
    /// `CLI-LINKS`: a node claims no link that its driver has not, and ends none
    /// (SM2-RES-002, SM2-LNK-004).
    KnowsItsLinks,
    /// `CLI-CONVERGE`: once all is quiet links are what matching says, on both sides, and
    /// quiet comes about (SM2-MAT-002, SM2-RES-002, SM2-RES-007).
    Converges,
    /// `MGR-MIRROR`: pages show what there is (SM2-IFC-007).
    MirrorIsExact,
    /// `MGR-TOTAL`, `MGR-INV`: no machine panics; with debug assertions the Manager's tables
    /// agree after each input.
    Invariants,
    /// `LNK-NOFALSE`: a correct end of a link accuses no correct one, and ends for a reason
    /// alone (SM2-OPN-006).
    EndAccusesNobody,
    /// `LNK-ORDER`: messages come in order and once, and none is lost but by keep-last
    /// (SM2-MSG-001, SM2-MSG-002, SM2-QOS-001, SM2-QOS-002).
    MessagesInOrder,
    /// `DAT-REFS`: a slot is written again after its release alone, and every slot and
    /// descriptor comes back (SM2-PAY-005, SM2-MSG-004, SM2-SEG-005, SM2-OPN-008).
    SlotsComeBack,
    /// `LNK-WINDOW`: no more messages are unreleased than the window says, and no more are
    /// held than may be (SM2-MSG-003, SM2-MSG-005).
    WithinWindow,
    /// `LNK-FATES`: each message is settled once and as it was, and counted so (SM2-QOS-004).
    FatesAreTrue,
    /// `RPC-ONCE`: each call that was made ends once, with its own reply or with the link
    /// (SM2-SRV-003, SM2-SRV-004, SM2-SRV-005).
    CallsEndOnce,
    /// `LNK-ABSORB`: nothing comes out of an end that is over (SM2-OPN-005, SM2-OPN-007).
    SilentAfterEnd,
    /// `LNK-QUIET`: once all is quiet both ends are open or both are over, and nothing that
    /// must be delivered is still to be (SM2-OPN-001, SM2-MSG-005).
    LinkComesToRest,
}

/// A property that does not hold.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Failure {
    /// Which.
    pub property: Property,
    /// A description of the failure.
    pub what: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: {}", self.property, self.what)
    }
}
