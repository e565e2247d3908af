//! Random histories of a domain whose Manager is killed and replaced: the shipped Managers and the
//! shipped nodes, with frames in flight that are delivered or lost at random.
//!
//! Checked at each step: no side is accused of a violation. Checked whenever all is quiet: each
//! pair that is to be linked has exactly one link, which is the one that it had as long as neither
//! end closed it; the nodes hold what the Manager shows; and `sm2_proto::domain` explains it.

// Shows CLI-SURVIVE, CLI-CONVERGE, MGR-INV, MGR-PACE (proptest).

use crate::support::{
    cases,
    contracts::{data, publisher_with, subscriber_with},
};
use crate::takeover::{NODES, World};
use proptest::{collection::vec, prelude::*};
use sm2_proto::Contract;
use sm2_proto::control::{Limit, Limits};

/// One event. The numbers pick among the nodes, interfaces and links that it can happen to.
#[derive(Clone, Debug)]
enum Step {
    Declare(usize, Contract),
    Withdraw(usize, usize),
    /// A node closes a link, for example after a violation.
    Break(usize, usize),
    /// A node sees that the other end of a link is closed.
    Notice(usize),
    ManagerReads(usize),
    NodeReads(usize),
    /// The Manager ends, and a part of its outputs is never sent.
    Kill(usize),
    /// The Manager says goodbye first.
    Shutdown,
    Start,
    Reconnect(usize),
    /// The Manager gives a node up.
    Stall(usize),
    /// The Manager continues its deferred work.
    GoOn,
    RunUntilQuiet,
}

fn contract() -> impl Strategy<Value = Contract> {
    // Some interfaces state a second type, so a repeated declaration may be refused.
    let data = prop_oneof![6 => Just("A"), 1 => Just("B")].prop_map(data);
    let topic = prop_oneof![Just("scan"), Just("image")];
    (topic, data, any::<[bool; 3]>()).prop_map(|(topic, data, [offers, reliable, sealed])| {
        if offers {
            publisher_with(topic, &data, reliable, sealed)
        } else {
            subscriber_with(topic, Some(&data), reliable, sealed)
        }
    })
}

fn step() -> impl Strategy<Value = Step> {
    let node = || 0..NODES;
    prop_oneof![
        6 => (node(), contract()).prop_map(|(node, contract)| Step::Declare(node, contract)),
        1 => (node(), 0..4_usize).prop_map(|(node, pick)| Step::Withdraw(node, pick)),
        1 => (node(), 0..4_usize).prop_map(|(node, pick)| Step::Break(node, pick)),
        3 => node().prop_map(Step::Notice),
        16 => node().prop_map(Step::ManagerReads),
        16 => node().prop_map(Step::NodeReads),
        3 => (0..6_usize).prop_map(Step::Kill),
        1 => Just(Step::Shutdown),
        4 => Just(Step::Start),
        6 => node().prop_map(Step::Reconnect),
        1 => node().prop_map(Step::Stall),
        4 => Just(Step::GoOn),
        2 => Just(Step::RunUntilQuiet),
    ]
}

/// The limit of LINKs in flight: almost all links wait, or hardly any.
fn limits() -> impl Strategy<Value = Limits> {
    let few = || prop_oneof![2 => Just(1_u32), 1 => Just(2), 1 => Just(256)];
    (few(), few()).prop_map(|(links_in_flight, work_per_turn)| {
        Limits::default()
            .with(Limit::LinksInFlight, links_in_flight)
            .with(Limit::WorkPerTurn, work_per_turn)
    })
}

proptest! {
    #![proptest_config(cases(200))]

    //= SM2-RES-001, SM2-RES-002, SM2-RES-004, SM2-RES-006, SM2-RES-007, SM2-NOD-003, SM2-MAT-002, SM2-LNK-006 model
    #[test]
    fn managers_come_and_go(limits in limits(), steps in vec(step(), 1..160)) {
        let mut world = World::with(limits);
        for step in steps {
            match step {
                Step::Declare(node, contract) => world.declare(node, contract),
                Step::Withdraw(node, pick) => world.withdraw(node, pick),
                Step::Break(node, pick) => world.break_link(node, pick),
                Step::Notice(node) => world.notice(node),
                Step::ManagerReads(node) => drop(world.manager_reads(node)),
                Step::NodeReads(node) => drop(world.node_reads(node)),
                Step::Kill(sent) => world.kill(sent),
                Step::Shutdown => world.shutdown(),
                Step::Start => world.start(),
                Step::Reconnect(node) => world.reconnect(node),
                Step::Stall(node) => world.stall(node),
                Step::GoOn => drop(world.go_on()),
                Step::RunUntilQuiet => {
                    world.run_until_quiet();
                    world.check();
                }
            }
        }
        world.run_until_quiet();
        world.check();
    }
}

/// A node whose own interfaces match is given up while the link between them is still pending, and the
/// Manager ends one link at a time. Both ends of that link are then gone.
//= SM2-LNK-006, SM2-SES-009 model
#[test]
fn a_pending_link_ends_once_if_both_interfaces_are_gone() {
    let mut world = World::with(
        Limits::default()
            .with(Limit::LinksInFlight, 1)
            .with(Limit::WorkPerTurn, 1),
    );
    world.run_until_quiet();
    let type_a = data("A");
    let publisher = || publisher_with("image", &type_a, false, false);
    world.declare(0, subscriber_with("image", Some(&type_a), false, false));
    world.run_until_quiet();
    world.declare(2, publisher());
    world.declare(0, publisher());
    world.manager_reads(2);
    world.manager_reads(0);
    world.stall(0);
    world.run_until_quiet();
    world.check();
}
