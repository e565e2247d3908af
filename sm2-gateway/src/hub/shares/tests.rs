use proptest::{
    prelude::*,
    test_runner::{Config, RngSeed},
};
use sm2_proto::{Name, TypeId};

use super::*;

const FLOODING: Process = Process { uid: 1, pid: 10 };
const HONEST: Process = Process { uid: 1, pid: 20 };
const OTHER: Process = Process { uid: 2, pid: 30 };
/// The descriptors of a topic with one publisher.
const ONE: u64 = 6;

fn topic(text: &str) -> Subject {
    let name = Name::new(text).unwrap();
    Subject::Topic {
        data: TypeId {
            name: name.clone(),
            hash: 0,
        },
        name,
        reliable: false,
        latched: 0,
    }
}

fn room(topics: u64) -> Shares {
    Shares::new(Room {
        descriptors: topics * ONE,
        ..Room::UNLIMITED
    })
}

fn changes(shares: &mut Shares) -> Vec<Change> {
    std::iter::from_fn(|| shares.poll()).collect()
}

/// A topic that a peer wants, with these publishers.
fn want(shares: &mut Shares, name: &str, links: &[(Process, u64)]) {
    shares.set_links(&topic(name), links.iter().copied().collect());
    shares.want(topic(name));
}

fn flood(shares: &mut Shares, count: u64) {
    for number in 0..count {
        want(shares, &format!("flood/{number}"), &[(FLOODING, 1)]);
    }
}

fn is_taken(shares: &Shares, name: &str) -> bool {
    let wanted = shares.wanted.get(&topic(name));
    wanted.is_some_and(|it| it.taken.is_some())
}

#[test]
fn a_process_has_all_of_the_room_until_another_one_needs_a_part() {
    let mut shares = room(100);
    flood(&mut shares, 700);
    let taken = |it: &Change| matches!(it, Change::Take(_));
    let said = changes(&mut shares);
    assert_eq!(said.iter().filter(|it| taken(it)).count(), 100);
    assert_eq!(said.len(), 700);
    want(&mut shares, "honest", &[(HONEST, 1)]);
    let newest = topic("flood/99");
    assert_eq!(
        changes(&mut shares),
        [
            Change::GiveUp(newest.clone()),
            Change::Wait(newest),
            Change::Take(topic("honest")),
        ]
    );
    // Each process has half of the room in the end.
    for number in 0..60 {
        want(&mut shares, &format!("honest/{number}"), &[(HONEST, 1)]);
    }
    assert_eq!(
        (shares.held(FLOODING), shares.held(HONEST)),
        (50 * ONE, 50 * ONE)
    );
    // Free room goes to the process that holds less.
    shares.unwant(&topic("flood/0"));
    assert_eq!(
        (shares.held(FLOODING), shares.held(HONEST)),
        (50 * ONE, 50 * ONE)
    );
    shares.unwant(&topic("honest"));
    assert_eq!(
        (shares.held(FLOODING), shares.held(HONEST)),
        (50 * ONE, 50 * ONE)
    );
    assert_eq!(shares.waiting().count(), 699 - 50 + 60 - 50);
}

/// An attempt that fails costs no process a topic.
#[test]
fn nothing_changes_if_there_cannot_be_enough_room() {
    let mut shares = room(10);
    flood(&mut shares, 10);
    changes(&mut shares);
    want(&mut shares, "crowded", &[(HONEST, 40)]);
    assert_eq!(changes(&mut shares), [Change::Wait(topic("crowded"))]);
    want(&mut shares, "full", &[(HONEST, 16)]);
    assert!(!is_taken(&shares, "full"), "its process would hold more");
    want(&mut shares, "fair", &[(HONEST, 13)]);
    assert!(is_taken(&shares, "fair"));
    assert_eq!(shares.used.descriptors, 10 * ONE);
}

#[test]
fn a_process_takes_no_topic_from_others_by_publishing_it_as_well() {
    let mut shares = room(100);
    // Before the other one, after it, and before the flood.
    want(&mut shares, "first", &[(FLOODING, 1)]);
    want(&mut shares, "second", &[(HONEST, 1)]);
    let both = [(FLOODING, 1), (HONEST, 1)];
    shares.set_links(&topic("first"), both.into());
    shares.set_links(&topic("second"), both.into());
    flood(&mut shares, 700);
    want(&mut shares, "third", &both);
    for number in 0..20 {
        want(&mut shares, &format!("honest/{number}"), &[(HONEST, 1)]);
        shares.set_links(&topic(&format!("honest/{number}")), both.into());
    }
    for name in ["first", "second", "third"] {
        assert!(is_taken(&shares, name), "{name}");
    }
    assert!((0..20).all(|it| is_taken(&shares, &format!("honest/{it}"))));
}

#[test]
fn a_topic_with_many_links_of_others_goes_first() {
    let mut shares = room(100);
    for name in ["one", "two", "three"] {
        want(&mut shares, name, &[(HONEST, 1)]);
    }
    want(&mut shares, "other", &[(OTHER, 1)]);
    shares.set_links(&topic("two"), [(HONEST, 1), (FLOODING, 700)].into());
    let taken = ["one", "two", "three", "other"].map(|it| is_taken(&shares, it));
    assert_eq!(taken, [true, false, true, true]);
    // The publishers have gone.
    shares.set_links(&topic("two"), [(HONEST, 1)].into());
    assert!(is_taken(&shares, "two"));
}

/// Of the topics of one process, and although newer ones are there.
#[test]
fn links_of_others_count_more_than_the_age_of_a_topic() {
    let mut shares = room(7);
    want(&mut shares, "shared", &[(FLOODING, 1)]);
    shares.set_links(&topic("shared"), [(FLOODING, 1), (OTHER, 3)].into());
    flood(&mut shares, 2);
    for number in 0..3 {
        want(&mut shares, &format!("other/{number}"), &[(OTHER, 1)]);
    }
    assert_eq!(shares.used.descriptors, 7 * ONE);
    changes(&mut shares);
    // The other process holds too much to take the topic over.
    want(&mut shares, "honest", &[(HONEST, 1)]);
    assert_eq!(
        changes(&mut shares),
        [
            Change::GiveUp(topic("shared")),
            Change::Wait(topic("shared")),
            Change::Take(topic("honest")),
        ]
    );
}

/// A process that publishes the topic as well, and that holds less, takes it over.
#[test]
fn a_topic_moves_to_another_publisher_before_it_is_given_up() {
    let mut shares = room(10);
    want(&mut shares, "shared", &[(FLOODING, 1)]);
    shares.set_links(&topic("shared"), [(FLOODING, 1), (OTHER, 1)].into());
    flood(&mut shares, 8);
    changes(&mut shares);
    assert_eq!((shares.held(FLOODING), shares.held(OTHER)), (56, 0));
    want(&mut shares, "honest", &[(HONEST, 1)]);
    assert_eq!(
        changes(&mut shares),
        [
            Change::GiveUp(topic("flood/7")),
            Change::Wait(topic("flood/7")),
            Change::Take(topic("honest")),
        ]
    );
    assert_eq!((shares.held(FLOODING), shares.held(OTHER)), (42, 8));
}

#[test]
fn the_process_that_left_a_topic_holds_it_no_longer() {
    let mut shares = room(10);
    want(&mut shares, "both", &[(HONEST, 1), (OTHER, 2)]);
    assert_eq!((shares.held(HONEST), shares.held(OTHER)), (10, 0));
    shares.set_links(&topic("both"), [(OTHER, 2)].into());
    assert_eq!((shares.held(HONEST), shares.held(OTHER)), (0, 8));
    shares.set_links(&topic("both"), Links::new());
    assert_eq!(shares.held(UNKNOWN), 6);
    shares.unwant(&topic("both"));
    assert_eq!((shares.used, shares.held.len()), (Room::NONE, 0));
}

#[test]
fn processes_share_the_interfaces_of_the_node_as_well() {
    let mut shares = Shares::new(Room::UNLIMITED);
    flood(&mut shares, 700);
    shares.set_interfaces(100);
    assert_eq!(shares.used.interfaces, 100);
    want(&mut shares, "honest", &[(HONEST, 1)]);
    assert!(is_taken(&shares, "honest"));
    assert_eq!(shares.used.interfaces, 100);
    assert_eq!(shares.held(FLOODING), 99 * ONE);
}

#[derive(Clone, Copy, Debug)]
enum Op {
    Want(u8),
    Unwant(u8),
    Links(u8, u64),
}

fn op() -> impl Strategy<Value = Op> {
    let topic = 0..40_u8;
    prop_oneof![
        4 => topic.clone().prop_map(Op::Want),
        1 => topic.clone().prop_map(Op::Unwant),
        1 => (topic, 0..3_u64).prop_map(|(topic, links)| Op::Links(topic, links)),
    ]
}

proptest! {
    #![proptest_config(Config {
        rng_seed: RngSeed::Fixed(sm2_test_support::seed()),
        ..Config::with_cases(64)
    })]

    /// Each process that publishes alone has what it wants, or as much as any other one.
    #[test]
    fn no_process_waits_while_another_one_holds_more(ops in prop::collection::vec(op(), 1..200)) {
        let mut shares = room(12);
        // The topics of a process have the same number of links, so the room is cut evenly.
        let of = |it: u8| Process { uid: 0, pid: i32::from(it) % 4 };
        for it in 0..40 {
            shares.set_links(&topic(&format!("t{it}")), [(of(it), 1)].into());
        }
        for op in ops {
            match op {
                Op::Want(it) => shares.want(topic(&format!("t{it}"))),
                Op::Unwant(it) => shares.unwant(&topic(&format!("t{it}"))),
                // None: the gateway does not know yet, so the process is another one.
                Op::Links(it, 0) => shares.set_links(&topic(&format!("t{it}")), Links::new()),
                Op::Links(it, _) => shares.set_links(&topic(&format!("t{it}")), [(of(it), 1)].into()),
            }
            shares.invariants();
            let most = shares.held.values().copied().max().unwrap_or(0);
            for subject in shares.waiting() {
                let process = shares.least(&shares.links_of(subject));
                prop_assert!(shares.used.descriptors + ONE > shares.room.descriptors);
                prop_assert!(shares.held(process) + ONE >= most, "{shares:?}");
            }
        }
    }
}
