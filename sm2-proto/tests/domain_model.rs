//! Random histories of a domain: the shipped Manager and the shipped nodes, with frames in flight
//! for a random time, against a naive oracle.
//!
//! Checked at each step: no correct node and no Manager is accused of a violation; refusals, links
//! and pages equal those of the oracle; revisions and link ids are not used twice. Checked whenever
//! all is quiet: both sides of each link know of it, and each pair that is to have a link has one.
//! Checked at the end: no state is kept of nodes that are gone, and rogues have changed nothing
//! that other nodes see.

// Shows MGR-RELEASE, MGR-MATCH, MGR-NOISE, CLI-NOFALSE, CLI-CONVERGE, MGR-INV, MGR-PACE (proptest), bound: up to 12
// nodes.

use crate::support::{
    cases,
    contracts::{client, data, name, publisher_with, server, service_qos, subscriber_with},
    world::World,
};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Code, Contract, Datagram, InterfaceId, LinkId,
    control::{ToManager, decode_to_manager, encode_to_manager},
};

/// One event. The numbers pick among the nodes, interfaces and links that it can happen to.
#[derive(Clone, Debug)]
enum Op {
    Start { slot: usize, name: u8, uid: u32 },
    Declare { slot: usize, contract: Contract },
    Withdraw { slot: usize, pick: usize },
    EndLink { slot: usize, pick: usize },
    Query { slot: usize },
    Goodbye { slot: usize },
    Crash { slot: usize },
    Stall { slot: usize },
    GoRogue { slot: usize, bytes: Vec<u8> },
    RunShort { links: u8 },
    Tick,
    ManagerReads { pick: usize },
    NodeReads { pick: usize },
    RunUntilQuiet,
}

fn contract() -> impl Strategy<Value = Contract> {
    let topic = prop_oneof![Just("scan"), Just("image")];
    let kind = prop_oneof![3 => Just("A"), 1 => Just("B")];
    let flags = (any::<bool>(), any::<bool>(), any::<bool>());
    (0..4_u8, topic, kind, flags).prop_map(|(contract, topic, kind, (reliable, sealed, stated))| {
        let data = data(kind);
        match contract {
            0 => publisher_with(topic, &data, reliable, sealed),
            1 => subscriber_with(topic, stated.then_some(&data), reliable, sealed),
            2 => server(topic, &data, &data),
            _ => {
                let mut client = client(topic, stated.then_some((&data, &data)));
                if let Contract::Client { qos, .. } = &mut client {
                    *qos = service_qos(sealed);
                }
                client
            }
        }
    })
}

/// Frames that no state allows: garbage, or unknown ids.
fn breach() -> impl Strategy<Value = Vec<u8>> {
    let nowhere = InterfaceId(u64::MAX);
    let unlinked = ToManager::Unlinked {
        interface: nowhere,
        link: LinkId {
            epoch: 0,
            serial: 1,
        },
        code: Code(0),
    };
    let declare = contract().prop_map(|contract| {
        let interface = InterfaceId(0);
        encode_to_manager(&ToManager::Declare {
            interface,
            contract,
        })
    });
    prop_oneof![
        vec(any::<u8>(), 1..40).prop_filter("garbage", |bytes| {
            decode_to_manager(&Datagram::new(bytes)).is_err()
        }),
        declare,
        Just(encode_to_manager(&ToManager::Withdraw {
            interface: nowhere
        })),
        Just(encode_to_manager(&unlinked)),
    ]
}

fn op() -> impl Strategy<Value = Op> {
    let slot = || 0..16_usize;
    let pick = || 0..16_usize;
    let uid = prop_oneof![3 => Just(1000_u32), 1 => Just(1001)];
    prop_oneof![
        8 => (slot(), 0..24_u8, uid).prop_map(|(slot, name, uid)| Op::Start { slot, name, uid }),
        14 => (slot(), contract()).prop_map(|(slot, contract)| Op::Declare { slot, contract }),
        4 => (slot(), pick()).prop_map(|(slot, pick)| Op::Withdraw { slot, pick }),
        4 => (slot(), pick()).prop_map(|(slot, pick)| Op::EndLink { slot, pick }),
        1 => slot().prop_map(|slot| Op::Query { slot }),
        1 => slot().prop_map(|slot| Op::Goodbye { slot }),
        2 => slot().prop_map(|slot| Op::Crash { slot }),
        1 => slot().prop_map(|slot| Op::Stall { slot }),
        2 => (slot(), breach()).prop_map(|(slot, bytes)| Op::GoRogue { slot, bytes }),
        1 => (1..4_u8).prop_map(|links| Op::RunShort { links }),
        10 => Just(Op::Tick),
        20 => pick().prop_map(|pick| Op::ManagerReads { pick }),
        20 => pick().prop_map(|pick| Op::NodeReads { pick }),
        1 => Just(Op::RunUntilQuiet),
    ]
}

/// The limit of LINKs in flight: so low that links wait, or so high that they hardly ever do.
fn ahead() -> impl Strategy<Value = usize> {
    prop_oneof![3 => 1..4_usize, 1 => Just(16)]
}

fn run(slots: usize, ahead: usize, ops: &[Op], rogues: bool) -> World {
    let mut world = World::new(slots, rogues, ahead);
    for op in ops.iter().cloned() {
        match op {
            Op::Start { slot, name: n, uid } => world.start(slot, name(&format!("n{n}")), uid),
            Op::Declare { slot, contract } => world.declare(slot, contract),
            Op::Withdraw { slot, pick } => world.withdraw(slot, pick),
            Op::EndLink { slot, pick } => world.end_link(slot, pick),
            Op::Query { slot } => world.query(slot),
            Op::Goodbye { slot } => world.say_goodbye(slot),
            Op::Crash { slot } => world.crash(slot),
            Op::Stall { slot } => world.stall(slot),
            Op::GoRogue { slot, bytes } => world.go_rogue(slot, &bytes),
            Op::RunShort { links } => world.run_short(links),
            Op::Tick => drop(world.tick()),
            Op::ManagerReads { pick } => drop(world.manager_reads(pick)),
            Op::NodeReads { pick } => drop(world.node_reads(pick)),
            Op::RunUntilQuiet => world.run_until_quiet(),
        }
    }
    world
}

proptest! {
    #![proptest_config(cases(300))]

    //= SM2-IFC-002, SM2-IFC-003, SM2-IFC-004, SM2-IFC-005, SM2-IFC-007 test
    //= SM2-MAT-001, SM2-MAT-002, SM2-MAT-003 test
    //= SM2-LNK-001, SM2-LNK-002, SM2-LNK-003, SM2-LNK-009, SM2-LNK-006, SM2-TRN-005 test
    #[test]
    fn a_few_nodes(slots in 2..5_usize, ahead in ahead(), ops in vec(op(), 1..120)) {
        run(slots, ahead, &ops, true).end();
    }

    //= SM2-SES-003, SM2-SES-005, SM2-SES-006 test
    #[test]
    fn rogues_change_nothing_for_the_others(
        slots in 2..6_usize,
        ahead in ahead(),
        ops in vec(op(), 1..120),
    ) {
        let (manager, trace) = run(slots, ahead, &ops, true).end();
        let (without, undisturbed) = run(slots, ahead, &ops, false).end();
        prop_assert_eq!(trace, undisturbed);
        prop_assert_eq!(manager, without);
    }
}

proptest! {
    #![proptest_config(cases(30))]

    //= SM2-MAT-002, SM2-LNK-003, SM2-IFC-007 test
    #[test]
    fn many_nodes(slots in 8..=16_usize, ahead in ahead(), ops in vec(op(), 200..600)) {
        run(slots, ahead, &ops, true).end();
    }
}
