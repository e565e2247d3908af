//! The latched state in incidents and in replays.

use std::collections::BTreeSet;
use std::fs;
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use sm2_bag::{
    Bag, BlackBox, BlackBoxOptions, BlackBoxStep, Filter, Folder, Options, PlayOptions, Player,
    check,
};
use sm2_node::clock::DomainTime;
use sm2_node::{Node, Shutdown};
use sm2_proto::Instant;

use crate::common::{Domain, SOON, named, until};
use crate::latched::{bags, latched, messages, parts, record_in};

/// The clocks of the black box, in nanoseconds. Only the test moves them.
static NOW_NS: AtomicU64 = AtomicU64::new(0);

fn wall_clock() -> DomainTime {
    DomainTime(NOW_NS.load(Ordering::SeqCst))
}

fn monotonic_clock() -> Instant {
    Instant(NOW_NS.load(Ordering::SeqCst))
}

#[test]
fn an_incident_begins_with_the_latched_state() {
    let domain = Domain::new();
    let stop = Shutdown::new().unwrap();
    NOW_NS.store(sm2_io::clock::now().0, Ordering::SeqCst);
    fs::create_dir(domain.path("out")).unwrap();
    let options = BlackBoxOptions {
        record: Options {
            sync_interval: Duration::from_millis(1),
            wall_clock,
            monotonic_clock,
            ..Options::new(named(&["map", "ticks"]))
        },
        last: Duration::from_secs(10),
        after: Duration::from_secs(1),
        triggers: Vec::new(),
        output: domain.path("out"),
        ring: domain.path("ring"),
    };
    let mut black_box = BlackBox::start(&domain.node("recorder"), options, stop.as_fd()).unwrap();
    let talker = domain.node("talker");
    let (map, ticks) = (
        latched(&talker, "map", 1),
        talker.publisher::<u64>("ticks").unwrap(),
    );
    let mut incidents = Vec::new();
    let mut step_until = |what, done: &mut dyn FnMut(&BlackBox<'_>, usize) -> bool| {
        until(what, || {
            match black_box.step(Duration::from_millis(1)).unwrap() {
                BlackBoxStep::Written(incident) => incidents.push(incident),
                BlackBoxStep::Timeout | BlackBoxStep::Woken => {}
                step => panic!("{step:?}"),
            }
            done(&black_box, incidents.len())
        });
    };
    step_until("the black box is linked", &mut |_, _| {
        let all = [map.links(), ticks.links()];
        all.iter().all(|it| it.iter().any(|link| link.open))
    });
    map.publish(b"map").unwrap();
    step_until("the map is written", &mut |it, _| {
        it.progress().messages == 1
    });
    let mut tick = |number| {
        NOW_NS.fetch_add(1_000_000_000, Ordering::SeqCst);
        ticks.publish(&number).unwrap();
        step_until("the tick is written", &mut |it, _| {
            it.progress().messages == number + 1
        });
    };
    (1..=30).for_each(&mut tick);
    assert!(incidents.is_empty());
    black_box.trigger("late");
    let incident = black_box.finish().unwrap().remove(0);
    incident.result.unwrap();
    assert_eq!(check(&incident.path).unwrap().damages, []);
    let bag = Bag::open(&incident.path).unwrap();
    let (repeated, others) = parts(&bag);
    assert_eq!(repeated, [b"map".to_vec()]);
    assert!(others.iter().all(|it| it == "ticks") && others.len() >= 10);
}

#[test]
fn a_replay_publishes_the_latched_state_first_and_once() {
    let domain = Domain::new();
    let path = domain.path("drive");
    record_in(&domain, Folder::new(&path, "bag").unwrap());
    let bags = bags(&path);
    let late = messages(&bags[2])[5].log_time;
    let listener = domain.node("listener").subscriber_builder::<[u8]>("map");
    let listener = listener.reliable(true).depth(64).declare().unwrap();
    let stop = Shutdown::new().unwrap();
    let connect = |name: &str| Node::builder(name).socket(domain.path("sock")).connect();
    for (chosen, from_ns, expected) in [
        // All files: the map once.
        (&bags[..], None, &["old", "map"][..]),
        // Files whose first one is gone, and the middle of all files.
        (&bags[1..], None, &["map"]),
        (&bags[..], Some(late), &["map"]),
    ] {
        let options = PlayOptions {
            rate: 0.0,
            filter: Filter {
                topics: BTreeSet::from(["map".to_owned()]),
                from_ns,
                ..Filter::default()
            },
            ..PlayOptions::default()
        };
        let mut player = Player::new(chosen, options, connect, stop.as_fd()).unwrap();
        // Twice, as with --loop.
        for _ in 0..2 {
            thread::scope(|scope| {
                scope.spawn(|| {
                    for expected in expected {
                        let message = listener.recv_timeout(SOON).unwrap().unwrap();
                        assert_eq!(&*message, expected.as_bytes());
                    }
                });
                assert!(player.play().unwrap().complete);
            });
        }
        drop(player);
        assert!(listener.try_recv().unwrap().is_none(), "{from_ns:?}");
    }
    // Nobody takes the messages in time.
    let options = PlayOptions {
        rate: 0.0,
        room_timeout: Duration::from_millis(10),
        ..PlayOptions::default()
    };
    let mut player = Player::new(&bags[..], options, connect, stop.as_fd()).unwrap();
    assert!(!player.play().unwrap().complete);
    assert!(listener.try_recv().unwrap().is_some());
}
