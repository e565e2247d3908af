//! All possible events on one link: small scopes, and faults that must be found. To search all
//! scopes and print traces: `cargo run --profile model -p sm2-verification --bin link-model`.

// Shows BITE-LINK, LNK-NOFALSE, LNK-ORDER, RPC-ONCE (test), bound: 19 faults in small scopes, each with its property
// and its shortest trace.

use sm2_verification::model::{
    Property, explore,
    link::{COUNTS, Fault, LinkScope},
};

/// Scopes that are small enough for a debug build: one or more of each kind.
const SMALL: [&str; 10] = [
    "link-keep-last-1",
    "link-debt",
    "link-reliable-1",
    "link-reliable-2",
    "link-full",
    "link-full-ends",
    "link-pooled",
    "link-calls-2",
    "link-calls-full",
    "link-cancels-full",
];

//= SM2-OPN-001, SM2-OPN-007, SM2-OPN-008, SM2-OPN-009, SM2-TRN-005 model
//= SM2-MSG-001, SM2-MSG-002, SM2-MSG-003, SM2-MSG-004, SM2-MSG-005 model
//= SM2-PAY-005, SM2-SEG-005, SM2-QOS-001, SM2-QOS-002, SM2-QOS-003, SM2-QOS-006 model
//= SM2-SRV-001, SM2-SRV-002, SM2-SRV-003, SM2-SRV-004 model
#[test]
fn nothing_breaks_in_the_small_scopes() {
    let count = if cfg!(feature = "slow") {
        SMALL.len()
    } else {
        6
    };
    for name in &SMALL[..count] {
        let scope = LinkScope::named(name).expect("a scope");
        let report = explore(&scope, usize::MAX);
        assert!(report.failure.is_none(), "{name}: {:?}", report.failure);
        assert!(COUNTS.has(name, &report), "{name}: {report} is new");
    }
}

#[test]
fn each_scope_is_counted() {
    let counted: Vec<_> = COUNTS.scopes().collect();
    let scopes: Vec<_> = LinkScope::all().iter().map(|it| it.name).collect();
    assert_eq!(counted, scopes);
}

/// Faults, each with its scope, the property that finds it, and the least number of steps until
/// then.
const FAULTS: [(Fault, &str, Property, usize); 19] = [
    (
        Fault::OpenLost,
        "link-keep-last-1",
        Property::LinkComesToRest,
        2,
    ),
    (
        Fault::OtherWindow,
        "link-reliable-1",
        Property::WithinWindow,
        6,
    ),
    (
        Fault::AttachLost,
        "link-retires",
        Property::EndAccusesNobody,
        6,
    ),
    (
        Fault::DetachLost,
        "link-retires",
        Property::EndAccusesNobody,
        14,
    ),
    (
        Fault::DataLost,
        "link-keep-last-1",
        Property::LinkComesToRest,
        5,
    ),
    (
        Fault::DataAgain,
        "link-keep-last-1",
        Property::MessagesInOrder,
        7,
    ),
    (
        Fault::DataOvertakes,
        "link-reliable-1",
        Property::EndAccusesNobody,
        7,
    ),
    (
        Fault::DataReplaces,
        "link-reliable-1",
        Property::MessagesInOrder,
        7,
    ),
    (
        Fault::ReleaseLost,
        "link-pooled",
        Property::SlotsComeBack,
        9,
    ),
    (
        Fault::ReleaseTwice,
        "link-keep-last-1",
        Property::EndAccusesNobody,
        10,
    ),
    (
        Fault::ReleaseEarly,
        "link-pooled",
        Property::SlotsComeBack,
        8,
    ),
    (
        Fault::OtherFate,
        "link-keep-last-1",
        Property::FatesAreTrue,
        9,
    ),
    (Fault::ReplyLost, "link-calls-2", Property::CallsEndOnce, 10),
    (Fault::OtherCall, "link-calls-2", Property::CallsEndOnce, 14),
    (
        Fault::CancelTwice,
        "link-calls-2",
        Property::EndAccusesNobody,
        9,
    ),
    (
        Fault::EndOvertakes,
        "link-ends",
        Property::MessagesInOrder,
        6,
    ),
    (
        Fault::KeptAfterEnd,
        "link-full-ends",
        Property::SilentAfterEnd,
        5,
    ),
    (
        Fault::AbandonedReused,
        "link-ends",
        Property::SlotsComeBack,
        9,
    ),
    (Fault::Panics, "link-full-ends", Property::Invariants, 3),
];

#[test]
fn each_fault_is_found() {
    for (fault, name, property, steps) in FAULTS {
        let mut scope = LinkScope::named(name).expect("a scope");
        scope.fault = Some(fault);
        let found = explore(&scope, usize::MAX).failure;
        let found = found.unwrap_or_else(|| panic!("{name} does not find {fault:?}"));
        println!(
            "{fault:?} in {name} after {} steps: {}",
            found.steps.len(),
            found.failure
        );
        let what = (found.failure.property, found.steps.len());
        assert_eq!(
            what,
            (property, steps),
            "{fault:?} in {name}: {:?}",
            found.steps
        );
    }
}
