//! Everything that can happen in small domains: the quick scopes. All of them, with their
//! traces: `cargo run --release -p sm2-verification --bin model`.

use sm2_verification::model::{Fault, Property, Scope, explore};

const COUNTS: &str = include_str!("../model-counts.txt");
/// Scopes that are small enough for a debug build.
const QUICK: [&str; 4] = [
    "cold-2x2",
    "churn-once-2x2",
    "takeovers-2x2",
    "takeover-3x2",
];

//= SM2-NOD-001, SM2-NOD-003, SM2-SES-005, SM2-SES-006, SM2-LNK-002, SM2-LNK-003, SM2-LNK-004 model
//= SM2-MAT-002, SM2-RES-002, SM2-RES-004, SM2-RES-007, SM2-IFC-004, SM2-IFC-007, SM2-TRN-006 model
#[test]
fn nothing_breaks_in_the_quick_scopes() {
    for name in QUICK {
        let scope = Scope::named(name).expect("a scope");
        let report = explore(&scope, usize::MAX);
        assert!(report.failure.is_none(), "{name}: {:?}", report.failure);
        let counts = format!(
            "{name} {} {} {} {}",
            report.states, report.transitions, report.depth, report.quiet
        );
        assert!(COUNTS.lines().any(|line| line == counts), "{counts} is new");
    }
}

#[test]
fn each_fault_is_found() {
    let faults = [
        (Fault::UnlinkedLost, "self-1x1", Property::OneFarewell),
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
            "crash-2x2",
            Property::ManagerAccusesNobody,
        ),
    ];
    let found = faults.map(|(fault, name, _)| {
        let mut scope = Scope::named(name).expect("a scope");
        scope.fault = Some(fault);
        let found = explore(&scope, usize::MAX).failure;
        (fault, name, found.map(|it| it.failure.property))
    });
    let wanted = faults.map(|(fault, name, property)| (fault, name, Some(property)));
    assert_eq!(found, wanted);
}
