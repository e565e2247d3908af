//! All possible events of a lockstep, and faults that must be found. To print traces: `cargo run --profile model -p
//! sm2-verification --bin lockstep-model`.

// Shows BITE-LOCKSTEP, LCK-NOFALSE, LCK-INPUTS, LCK-REST (test), bound: 6 faults, each with its property.

use sm2_verification::model::{
    Property, explore,
    lockstep::{COUNTS, Fault, LockstepScope},
};

//= SM2-LCK-001, SM2-LCK-002, SM2-LCK-003, SM2-LCK-004, SM2-LCK-007, SM2-LCK-008 model
#[test]
fn nothing_breaks_in_any_scope() {
    for scope in LockstepScope::all() {
        let name = scope.name;
        let report = explore(&scope, usize::MAX);
        assert!(report.failure.is_none(), "{name}: {:?}", report.failure);
        assert!(COUNTS.has(name, &report), "{name}: {report} is new");
    }
}

/// The inputs are at 3, 6 and 9, and the ticks at 5, 7 and 9: the last ones share a step.
#[test]
fn a_tick_at_the_time_of_an_input_has_no_step_of_its_own() {
    let timer = LockstepScope::named("lockstep-timer").expect("a scope");
    let scope = LockstepScope {
        members: 2,
        inputs: 3,
        ..timer
    };
    let report = explore(&scope, usize::MAX);
    assert!(report.failure.is_none(), "{:?}", report.failure);
    assert_eq!(report.quiet, 1, "{report}");
}

#[test]
fn each_scope_is_counted() {
    let counted: Vec<_> = COUNTS.scopes().collect();
    let scopes: Vec<_> = LockstepScope::all().iter().map(|it| it.name).collect();
    assert_eq!(counted, scopes);
}

/// Faults, each with its scope and the property that finds it.
const FAULTS: [(Fault, &str, Property); 6] = [
    (Fault::CutEarly, "lockstep-3", Property::InputsAreFixed),
    (Fault::IgnoresCut, "lockstep-3", Property::InputsAreFixed),
    (Fault::FinishesEarly, "lockstep-3", Property::InputsAreFixed),
    (Fault::TakenIsZero, "lockstep-2", Property::InputsAreFixed),
    (Fault::EndUnseen, "lockstep-deaths", Property::StepsEnd),
    (
        Fault::TurnTwice,
        "lockstep-2",
        Property::LockstepAccusesNobody,
    ),
];

#[test]
fn each_fault_is_found() {
    for (fault, name, property) in FAULTS {
        let mut scope = LockstepScope::named(name).expect("a scope");
        scope.fault = Some(fault);
        let found = explore(&scope, usize::MAX).failure;
        let found = found.unwrap_or_else(|| panic!("{name} does not find {fault:?}"));
        println!(
            "{fault:?} in {name} after {} steps: {}",
            found.steps.len(),
            found.failure
        );
        assert_eq!(
            found.failure.property, property,
            "{fault:?}: {:?}",
            found.steps
        );
    }
}
