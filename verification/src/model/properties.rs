//! The checked properties, and the report of a broken one.

use std::fmt;

/// A checked property, with the clauses that require it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Property {
    /// `MGR-STRICT`: a correct Manager closes no session of a correct node (SM2-SES-005).
    ManagerAccusesNobody,
    /// `CLI-NOFALSE`: a correct node accuses no correct Manager (SM2-NOD-001).
    NodeAccusesNobody,
    /// `MGR-MATCH`: no pair has two links that both ends regard as live (SM2-MAT-002).
    OneLinkPerPair,
    /// `MGR-IDS`: ids of links are never reused (SM2-LNK-002).
    FreshIds,
    /// `LNK-FAREWELL`: one farewell per end and direction of a session (SM2-LNK-003).
    OneFarewell,
    /// `CLI-SURVIVE`: a link that no side had a reason to end does not end, and keeps its id across
    /// a take-over (SM2-NOD-003, SM2-RES-004).
    LinksSurvive,
    /// `CLI-LINKS`: a node claims no link that its driver does not have, and ends none
    /// (SM2-RES-002, SM2-LNK-009).
    KnowsItsLinks,
    /// `CLI-CONVERGE`: once all is quiet, both sides have exactly the links that matching requires,
    /// and quiet is always reached (SM2-MAT-002, SM2-RES-002, SM2-RES-007).
    Converges,
    /// `MGR-MIRROR`: pages show the exact state (SM2-IFC-007).
    MirrorIsExact,
    /// `ACC-RELOAD`: exactly those interfaces are suspended that the access policy denies, and their
    /// links have ended once the policy is applied (SM2-ACC-009, SM2-ACC-013, SM2-ACC-014).
    PolicyHolds,
    /// `MGR-PACE`: a node has no more links than it stated room for, and no link waits while there
    /// is room (SM2-LNK-007).
    WithinRoom,
    /// `MGR-TOTAL`, `MGR-INV`: no machine panics. With debug assertions, the Manager's tables agree
    /// after each input.
    Invariants,
    /// `LNK-NOFALSE`: a correct end of a link accuses no correct end, and never ends without a
    /// reason (SM2-OPN-008).
    EndAccusesNobody,
    /// `LNK-ORDER`: messages arrive in order and once, and only keep-last loses any (SM2-MSG-001,
    /// SM2-MSG-002, SM2-QOS-001, SM2-QOS-002).
    MessagesInOrder,
    /// `DAT-REFS`: a slot is written again only after its release, and every slot and descriptor is
    /// returned (SM2-PAY-005, SM2-MSG-004, SM2-SEG-005, SM2-OPN-010).
    SlotsComeBack,
    /// `LNK-WINDOW`: at most `window` messages are unreleased, and at most `max_borrowed` are held
    /// (SM2-MSG-003, SM2-MSG-005).
    WithinWindow,
    /// `LNK-FATES`: each message is settled once, with its true fate, and counted accordingly
    /// (SM2-QOS-006).
    FatesAreTrue,
    /// `LNK-DEBT`: a link owes exactly while a message is in flight that was in flight when a publication
    /// last missed the link (SM2-QOS-003).
    DebtIsTrue,
    /// `RPC-ONCE`: each call ends once, with its own reply or with the link (SM2-SRV-002,
    /// SM2-SRV-003, SM2-SRV-004).
    CallsEndOnce,
    /// `LNK-ABSORB`: an end that has ended has no outputs (SM2-OPN-007, SM2-OPN-009).
    SilentAfterEnd,
    /// `LNK-QUIET`: once all is quiet, both ends are open or both have ended, and no message that
    /// must be delivered is pending (SM2-OPN-001, SM2-MSG-005).
    LinkComesToRest,
    /// `LCK-NOFALSE`: a correct conductor refuses no call of a correct member, and a correct member
    /// gets no illegal turn (SM2-LCK-007, SM2-LCK-008).
    LockstepAccusesNobody,
    /// `LCK-INPUTS`: at the end of a step, no member has an input of the step that it has not handled; as
    /// long as nobody joins or leaves, the inputs of each turn do not depend on the order of events
    /// (SM2-LCK-003, SM2-LCK-004, SM2-LCK-005).
    InputsAreFixed,
    /// `LCK-REST`: a step ends, also if members die or join (SM2-LCK-002, SM2-LCK-003, SM2-LCK-007).
    StepsEnd,
}

/// A property that does not hold.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Failure {
    /// The broken property.
    pub property: Property,
    /// A description of the failure.
    pub what: String,
}

/// A property does not hold.
pub(super) fn fail<T>(property: Property, what: String) -> Result<T, Failure> {
    Err(Failure { property, what })
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: {}", self.property, self.what)
    }
}
