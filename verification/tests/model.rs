//! All possible events in small domains: the scopes that a debug build can search. To search all
//! scopes and print traces: `cargo run --profile model -p sm2-verification --bin model`.

use sm2_verification::model::{
    Property,
    domain::{COUNTS, Fault, Findings, Scope},
    explore,
};

/// Scopes that are small enough for a debug build.
const SMALL: [&str; 11] = [
    "cold-2x2",
    "takeovers-2x2",
    "takeover-3x2",
    "deadline-3x1",
    "liveliness-3x1",
    "room-3x1",
    "stall-2x2",
    "churn-once-2x2",
    "crash-2x1",
    "cold-crash-2x1",
    "reload-exclusive-3x1",
];
/// The scopes that a debug build can also search without reductions.
const SMALLEST: [&str; 5] = [
    "cold-2x2",
    "takeovers-2x2",
    "takeover-3x2",
    "crash-2x1",
    "churn-once-2x2",
];

/// Faults of the harness, each with the scope and the property that find it.
const FAULTS: [(Fault, &str, Property); 13] = [
    (Fault::UnlinkedLost, "crash-2x1", Property::OneFarewell),
    (
        Fault::WithdrawnOvertakes,
        "churn-once-2x2",
        Property::NodeAccusesNobody,
    ),
    (
        Fault::DeclaredTwice,
        "cold-2x2",
        Property::NodeAccusesNobody,
    ),
    (Fault::OtherTerms, "cold-2x2", Property::NodeAccusesNobody),
    (Fault::OtherKey, "takeovers-2x2", Property::OneLinkPerPair),
    (Fault::EpochAgain, "takeovers-2x2", Property::LinksSurvive),
    (
        Fault::ClaimedLost,
        "takeovers-2x2",
        Property::ManagerAccusesNobody,
    ),
    (
        Fault::EndUnseen,
        "crash-2x1",
        Property::ManagerAccusesNobody,
    ),
    (Fault::DeclareLost, "cold-2x2", Property::Converges),
    (Fault::LinkTwice, "cold-2x2", Property::FreshIds),
    (Fault::ItemLost, "takeovers-2x2", Property::MirrorIsExact),
    (Fault::SessionAgain, "cold-2x2", Property::Invariants),
    (Fault::HangUpUnsaid, "crash-2x1", Property::KnowsItsLinks),
];

/// Faults in scopes that are always searched without reductions.
const UNREDUCED_FAULTS: [(Fault, &str, Property); 2] = [
    (
        Fault::PolicyLost,
        "reload-exclusive-3x1",
        Property::PolicyHolds,
    ),
    (Fault::RoomOverstated, "room-3x1", Property::WithinRoom),
];

/// All of them with the feature `slow`, the first ones without.
fn part_of<T>(all: &[T], first: usize) -> &[T] {
    if cfg!(feature = "slow") {
        all
    } else {
        &all[..first]
    }
}

fn as_it_is(name: &str, fault: Option<Fault>) -> Scope {
    let scope = Scope::named(name).expect("a scope");
    Scope { fault, ..scope }
}

fn named(name: &str, fault: Option<Fault>, reduced: bool) -> Scope {
    Scope {
        reduced,
        ..as_it_is(name, fault)
    }
}

//= SM2-NOD-001, SM2-NOD-003, SM2-SES-005, SM2-SES-006, SM2-LNK-002, SM2-LNK-003, SM2-LNK-009 model
//= SM2-MAT-002, SM2-RES-002, SM2-RES-004, SM2-RES-007, SM2-IFC-004, SM2-IFC-007, SM2-TRN-005 model
//= SM2-ACC-009, SM2-ACC-013, SM2-ACC-014, SM2-LNK-007 model
#[test]
fn nothing_breaks_in_the_small_scopes() {
    for &name in part_of(&SMALL, 9) {
        let report = explore(&as_it_is(name, None), usize::MAX);
        assert!(report.failure.is_none(), "{name}: {:?}", report.failure);
        assert!(COUNTS.has(name, &report), "{name}: {report} is new");
    }
}

#[test]
fn each_fault_is_found() {
    for (fault, name, property) in FAULTS.into_iter().chain(UNREDUCED_FAULTS) {
        let found = Findings::of(&as_it_is(name, Some(fault)));
        let failures = found.map(|it| it.failures).unwrap_or_default();
        assert!(failures.contains(&property), "{fault:?} in {name}");
    }
}

/// Also one of a debug assertion: this one is about the Manager's driver.
#[cfg(debug_assertions)]
#[test]
fn a_panic_is_found() {
    let report = explore(&named("cold-2x2", Some(Fault::Unpolled), true), usize::MAX);
    let failure = report.failure.expect("a failure").failure;
    assert_eq!(failure.property, Property::Invariants);
    assert!(failure.what.contains("polled first"), "{failure}");
}

#[test]
fn reductions_lose_nothing() {
    for &name in part_of(&SMALLEST, 1) {
        let [reduced, whole] = [true, false]
            .map(|reduced| Findings::of(&named(name, None, reduced)).expect("a search to its end"));
        assert!(reduced.states < whole.states, "{name} is not reduced");
        assert!(!whole.quiet.is_empty());
        assert_eq!(whole.failures, reduced.failures, "{name}");
        assert!(whole.say_the_same(&reduced), "{name}: other quiet moments");
    }
}

#[test]
fn reductions_hide_no_fault() {
    for &(fault, name, _) in part_of(&FAULTS, 4) {
        let [reduced, whole] = [true, false].map(|reduced| {
            let found = Findings::of(&named(name, Some(fault), reduced));
            found.map(|it| it.failures).expect("a search to its end")
        });
        assert_eq!(reduced, whole, "{fault:?} in {name}");
    }
}
