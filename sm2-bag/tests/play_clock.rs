//! A player that publishes domain time is its only source.

use std::os::fd::AsFd;
use std::slice;

use sm2_bag::{Bag, Options, PlayOptions, Player};
use sm2_node::clock::{ClockSource, DomainTime};
use sm2_node::{Name, Node, Shutdown, Subscriber};

use crate::common::{Domain, named, record};

/// Records a domain with a source of time, whose readings say 1 to 5 ns.
fn record_clock(domain: &Domain) {
    let simulator = domain.node("simulator");
    let source = ClockSource::new(&simulator).unwrap();
    let numbers = simulator.publisher::<u64>("numbers").unwrap();
    let node = domain.node("recorder");
    let options = Options::new(named(&["clock", "numbers"]));
    record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| {
            source.listeners().1 == 1 && numbers.links().iter().any(|it| it.open)
        });
        for number in 1..=5 {
            source.set(DomainTime(number), 0).unwrap();
            numbers.publish(&number).unwrap();
            record_until(&mut |it| it.progress().messages == 2 * number);
        }
    });
}

/// The publishers' nodes of the messages that have come.
fn publishers(subscriber: &Subscriber<[u8]>) -> Vec<String> {
    let samples = std::iter::from_fn(|| subscriber.try_recv().unwrap());
    samples.map(|it| it.publisher().to_string()).collect()
}

/// Plays the bag in a domain of its own. Returns whether the player leaves domain time out, and the publishers of each
/// message of `clock`, `numbers` and `old/clock`.
fn play(bag: &Bag, options: PlayOptions) -> (bool, [Vec<String>; 3]) {
    let domain = Domain::new();
    let node = domain.node("listener");
    let topics = ["clock", "numbers", "old/clock"];
    let subscribers = topics.map(|topic| {
        let builder = node.subscriber_builder::<[u8]>(topic).any_type();
        builder.depth(64).declare().unwrap()
    });
    let options = PlayOptions {
        rate: 0.0,
        ..options
    };
    let shutdown = Shutdown::new().unwrap();
    let connect = |name: &str| Node::builder(name).socket(domain.path("sock")).connect();
    let bags = slice::from_ref(bag);
    let mut player = Player::new(bags, options, connect, shutdown.as_fd()).unwrap();
    let report = player.play().unwrap();
    assert!(report.complete);
    let has_clock = report.topics.iter().any(|it| it.name == "clock");
    assert!(!(has_clock && player.omits_clock()), "{report:?}");
    (player.omits_clock(), subscribers.map(|it| publishers(&it)))
}

#[test]
fn recorded_domain_time_is_no_second_source() {
    let domain = Domain::new();
    record_clock(&domain);
    let bag = Bag::open(&domain.path("bag")).unwrap();
    let (recorded, player) = ("play/simulator", "play/conductor");

    let (omits, [clock, numbers, _]) = play(&bag, PlayOptions::default());
    assert!(!omits);
    assert_eq!((clock, numbers.len()), (vec![recorded.to_owned(); 5], 5));

    let with_clock = || PlayOptions {
        clock: true,
        ..PlayOptions::default()
    };
    let in_lockstep = PlayOptions {
        lockstep: Some(0),
        ..PlayOptions::default()
    };
    for options in [with_clock(), in_lockstep] {
        let (omits, [clock, numbers, _]) = play(&bag, options);
        assert!(omits && !clock.is_empty());
        assert!(clock.iter().all(|it| it == player), "{clock:?}");
        assert_eq!(numbers.len(), 5);
    }

    // Under another name it is not a source; another topic under the name `clock` would be one.
    let name = |text| Name::new(text).unwrap();
    let renamed = PlayOptions {
        remap: [(name("clock"), name("old/clock"))].into(),
        ..with_clock()
    };
    let (omits, [clock, numbers, old]) = play(&bag, renamed);
    assert!(!omits && clock.iter().all(|it| it == player), "{clock:?}");
    assert_eq!((numbers.len(), old), (5, vec![recorded.to_owned(); 5]));
    let swapped = PlayOptions {
        remap: [
            (name("clock"), name("old/clock")),
            (name("numbers"), name("clock")),
        ]
        .into(),
        ..with_clock()
    };
    let (omits, [clock, numbers, old]) = play(&bag, swapped);
    assert!(omits && clock.iter().all(|it| it == player), "{clock:?}");
    assert_eq!((numbers.len(), old.len()), (0, 5));
}
