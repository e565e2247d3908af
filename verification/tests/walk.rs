//! Random walks through domains that are too large to search: 8 to 16 nodes with several topics and
//! services. Each moment is checked. At the end of each walk all pending work is completed; then
//! both sides must have exactly the links that the matching rules of SPEC require.

// Shows MGR-MATCH, MGR-MIRROR, CLI-NOFALSE, CLI-CONVERGE (proptest), bound: 48 walks of up to 500 choices, 8 to 16
// nodes, up to 48 interfaces.

use std::cell::Cell;

use proptest::{
    collection::{SizeRange, vec},
    prelude::*,
    sample::select,
    test_runner::{
        Config, FileFailurePersistence, RngAlgorithm, TestCaseError, TestError, TestRng, TestRunner,
    },
};
use sm2_proto::{Contract, DemandedQos, Name, OfferedQos, ServiceQos, TypeId};
use sm2_verification::model::{
    Failure, Property,
    domain::{Action, Budget, Fault, Restriction, Scope, World},
};

/// The number of domains that are walked through.
const CASES: u32 = if cfg!(feature = "slow") { 48 } else { 8 };
/// The number of domains where a fault has to be found.
const FAULT_CASES: u32 = 48;
/// One step in this many may be any action. The others complete pending work, if there is any.
const CALM: u16 = 5;

#[derive(Clone, Debug)]
struct Walk {
    programs: Vec<Vec<Contract>>,
    /// The index of the action in each step, modulo the number of actions.
    choices: Vec<u16>,
}

fn name(text: &str) -> Name {
    Name::new(text).expect("a legal name")
}

fn data(text: &str) -> TypeId {
    TypeId {
        name: name(text),
        hash: 7,
    }
}

fn contract() -> impl Strategy<Value = Contract> {
    let topics = || select(vec!["lidar", "camera", "odometry"]);
    let publisher =
        (topics(), any::<bool>(), any::<bool>()).prop_map(|(topic, reliable, sealed)| {
            Contract::Publisher {
                topic: name(topic),
                data: data("T"),
                offer: OfferedQos {
                    reliable,
                    sealed,
                    ..OfferedQos::new(1)
                },
            }
        });
    let subscriber =
        (topics(), any::<bool>(), any::<bool>()).prop_map(|(topic, reliable, typed)| {
            Contract::Subscriber {
                topic: name(topic),
                data: typed.then(|| data("T")),
                demand: DemandedQos {
                    reliable,
                    ..DemandedQos::new(1, 1)
                },
            }
        });
    let qos = |sealed| ServiceQos {
        depth: 1,
        max_borrowed: 1,
        sealed,
    };
    let services = || select(vec!["plan", "arm/grasp"]);
    let server = (services(), any::<bool>()).prop_map(move |(service, sealed)| Contract::Server {
        service: name(service),
        request: data("Q"),
        reply: data("A"),
        qos: qos(sealed),
    });
    let client = (services(), any::<bool>()).prop_map(move |(service, typed)| Contract::Client {
        service: name(service),
        types: typed.then(|| (data("Q"), data("A"))),
        qos: qos(false),
    });
    prop_oneof![2 => publisher, 3 => subscriber, 1 => server, 2 => client]
}

fn walk(nodes: SizeRange, longest: usize) -> impl Strategy<Value = Walk> {
    let programs = vec(vec(contract(), 1..=3), nodes);
    (programs, vec(any::<u16>(), 0..=longest))
        .prop_map(|(programs, choices)| Walk { programs, choices })
}

fn scope(walk: &Walk, fault: Option<Fault>) -> Scope {
    Scope {
        name: "walk",
        programs: walk.programs.clone(),
        budget: Budget {
            withdrawals: 8,
            closes: 5,
            node_crashes: 4,
            manager_crashes: 2,
            stalls: 3,
            shutdowns: 1,
            reloads: 2,
        },
        eager: false,
        starts_linked: false,
        reduced: false,
        // Every second walk has a Manager that cuts its work after each link.
        work_per_turn: [1, 512][walk.choices.len() % 2],
        restriction: Restriction::NoSubscriber,
        max_links: None,
        fault,
    }
}

/// Returns the number of steps.
fn go(walk: &Walk, fault: Option<Fault>) -> Result<usize, Failure> {
    let scope = scope(walk, fault);
    let mut world = World::new(&scope)?;
    let mut steps = 0;
    for &choice in &walk.choices {
        let mut actions = world.actions(&scope);
        world.check(&scope, &actions)?;
        let calm = choice % CALM != 0 && actions.iter().any(Action::goes_on);
        actions.retain(|it| !calm || it.goes_on());
        if actions.is_empty() {
            break;
        }
        let action = actions[usize::from(choice / CALM) % actions.len()];
        world = world.step(&scope, action)?;
        steps += 1;
    }
    world.linked(&scope)?;
    Ok(steps)
}

fn checked(walk: &Walk, fault: Option<Fault>) -> Result<usize, TestCaseError> {
    go(walk, fault).map_err(|failure| TestCaseError::fail(failure.to_string()))
}

//= SM2-MAT-001, SM2-MAT-002, SM2-MAT-003, SM2-IFC-007, SM2-NOD-001, SM2-SES-005, SM2-SES-008 test
//= SM2-LNK-002, SM2-LNK-003, SM2-LNK-009, SM2-RES-002, SM2-RES-004, SM2-RES-007 test
#[test]
fn random_walks_end_as_matching_says() {
    let file = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/walk.proptest-regressions"
    );
    let cases = match std::env::var_os("PROPTEST_CASES") {
        Some(_) => Config::default().cases,
        None => CASES,
    };
    let config = Config {
        cases,
        failure_persistence: Some(Box::new(FileFailurePersistence::Direct(file))),
        source_file: Some(file!()),
        ..Config::default()
    };
    let steps = Cell::new(0);
    let result = TestRunner::new(config).run(&walk((8..=16).into(), 500), |walk| {
        steps.set(steps.get() + checked(&walk, None)?);
        Ok(())
    });
    let covered = format!("{cases} walks, ~{} steps", steps.get());
    println!("{covered}");
    assert!(steps.get() > 0);
    if let Err(failure) = result {
        panic!("{failure}");
    }
}

/// A fault is found, and the shrunk walk has at most two thirds of the steps.
#[test]
fn a_fault_is_found_and_shrinks() {
    let config = Config {
        cases: FAULT_CASES,
        max_shrink_iters: 300,
        failure_persistence: None,
        ..Config::default()
    };
    let rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let fault = Some(Fault::EndUnseen);
    let first = Cell::new(None);
    let size = |walk: &Walk| {
        let interfaces: usize = walk.programs.iter().map(Vec::len).sum();
        interfaces + walk.choices.len()
    };
    let found = TestRunner::new_with_rng(config, rng).run(&walk(8.into(), 60), |walk| {
        checked(&walk, fault).map(drop).inspect_err(|_| {
            first.set(first.get().or(Some(size(&walk))));
        })
    });
    let Err(TestError::Fail(reason, shrunk)) = found else {
        panic!("the fault was not found: {found:?}");
    };
    let what = reason.message();
    let expected = format!("{:?}", Property::ManagerAccusesNobody);
    assert!(what.starts_with(&expected), "{what}");
    let (left, first) = (size(&shrunk), first.get().expect("a first failure"));
    assert!(left * 3 < first * 2, "{left} of {first}");
}
