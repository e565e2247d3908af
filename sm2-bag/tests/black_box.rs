//! A black box keeps what was before a trigger, and what comes soon after it.

use std::fs;
use std::os::fd::AsFd;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use sm2_bag::{
    Bag, BlackBox, BlackBoxOptions, BlackBoxStep, Filter, Incident, Options, Trigger, check,
};
use sm2_node::{Name, Node, Publisher, Shutdown};

use crate::common::{Domain, SOON, named};

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

/// The options of a black box for the topic `numbers`.
fn options(domain: &Domain, last: Duration, triggers: Vec<Trigger>) -> BlackBoxOptions {
    fs::create_dir_all(domain.path("out")).unwrap();
    BlackBoxOptions {
        record: Options {
            sync_interval: Duration::from_millis(10),
            ..Options::new(named(&["numbers"]))
        },
        last,
        after: Duration::from_millis(300),
        triggers,
        output: domain.path("out"),
        ring: domain.path("ring"),
    }
}

/// A publisher of consecutive numbers.
struct Counter {
    publisher: Publisher<u64>,
    next: u64,
}

impl Counter {
    fn new(node: &Node) -> Self {
        Self {
            publisher: node.publisher("numbers").unwrap(),
            next: 0,
        }
    }

    fn publish(&mut self) {
        self.publisher.publish(&self.next).unwrap();
        self.next += 1;
    }

    fn wait_for_link(&self, black_box: &mut BlackBox<'_>) {
        while !self.publisher.links().iter().any(|it| it.open) {
            black_box.step(Duration::from_millis(5)).unwrap();
        }
    }
}

/// Publishes a number every 10 ms until `done` returns true for a step.
fn run(
    black_box: &mut BlackBox<'_>,
    counter: &mut Counter,
    mut done: impl FnMut(BlackBoxStep) -> bool,
) {
    let until = Instant::now() + SOON;
    loop {
        assert!(Instant::now() < until, "nothing happened");
        counter.publish();
        let step = black_box.step(Duration::from_millis(10)).unwrap();
        if done(step) {
            return;
        }
    }
}

/// The numbers of a bag, which is complete. They are consecutive.
fn numbers(path: &Path) -> Vec<u64> {
    assert_eq!(check(path).unwrap().damages, []);
    let bag = Bag::open(path).unwrap();
    let messages = bag.messages(&Filter::default()).unwrap();
    let numbers = messages.map(|it| u64::from_le_bytes(it.unwrap().data.try_into().unwrap()));
    let numbers: Vec<_> = numbers.collect();
    assert!(
        numbers.windows(2).all(|it| it[1] == it[0] + 1),
        "{numbers:?}"
    );
    numbers
}

fn written(incident: Incident) -> Vec<u64> {
    incident.result.unwrap();
    numbers(&incident.path)
}

#[test]
fn overlapping_triggers_each_get_their_time() {
    let domain = Domain::new();
    let node = domain.node("recorder");
    let shutdown = Shutdown::new().unwrap();
    let options = options(&domain, Duration::from_millis(2_500), Vec::new());
    let mut black_box = BlackBox::start(&node, options, shutdown.as_fd()).unwrap();
    let talker = domain.node("talker");
    let mut counter = Counter::new(&talker);
    counter.wait_for_link(&mut black_box);
    let begin = Instant::now();
    run(&mut black_box, &mut counter, |_| {
        begin.elapsed() > Duration::from_secs(5)
    });
    let first = black_box.trigger("first");
    let first_at = counter.next;
    let begin = Instant::now();
    run(&mut black_box, &mut counter, |_| {
        begin.elapsed() > Duration::from_millis(100)
    });
    let second = black_box.trigger("second");
    let second_at = counter.next;
    assert_ne!(first, second);
    let mut incidents = Vec::new();
    run(&mut black_box, &mut counter, |step| {
        if let BlackBoxStep::Written(incident) = step {
            incidents.push(incident);
        }
        incidents.len() == 2
    });
    for (incident, path, reason, at) in [
        (incidents.remove(0), first, "first", first_at),
        (incidents.remove(0), second, "second", second_at),
    ] {
        assert_eq!((&incident.path, incident.reason.as_str()), (&path, reason));
        let numbers = written(incident);
        assert!(numbers.contains(&(at - 1)), "{at}: {numbers:?}");
        let before = numbers.iter().filter(|it| **it < at).count();
        let after = numbers.len() - before;
        // A busy machine publishes fewer numbers in the time.
        assert!(before > after && after > 0, "{numbers:?}");
        // The first half of the five seconds is not there.
        assert!(numbers[0] > 0, "{numbers:?}");
    }
    let files = fs::read_dir(domain.path("ring")).unwrap().count();
    assert!(files <= 8, "{files} files in the ring");
    black_box.finish().unwrap();
    assert!(!domain.path("ring").exists());
}

#[test]
fn an_end_writes_the_incidents_that_are_open() {
    let domain = Domain::new();
    let node = domain.node("recorder");
    let shutdown = Shutdown::new().unwrap();
    let options = BlackBoxOptions {
        after: Duration::from_secs(3_600),
        ..options(&domain, Duration::from_secs(60), Vec::new())
    };
    let mut black_box = BlackBox::start(&node, options, shutdown.as_fd()).unwrap();
    let talker = domain.node("talker");
    let mut counter = Counter::new(&talker);
    counter.wait_for_link(&mut black_box);
    let mut left = 20;
    run(&mut black_box, &mut counter, |_| {
        left -= 1;
        left == 0
    });
    black_box.trigger("end");
    let incidents = black_box.finish().unwrap();
    assert_eq!(incidents.len(), 1);
    for incident in incidents {
        assert!(written(incident).len() >= 19);
    }
}

#[test]
fn each_kind_of_trigger_works() {
    let domain = Domain::new();
    let node = domain.node("recorder");
    let shutdown = Shutdown::new().unwrap();
    let victim = domain.node("victim");
    let triggers = vec![
        Trigger::Message(name("alarm")),
        Trigger::Service(name("record/trigger")),
        Trigger::LostNode(name("victim")),
        Trigger::MissedDeadline(name("heartbeat"), Duration::from_millis(400)),
    ];
    let options = options(&domain, Duration::from_secs(60), triggers);
    let mut black_box = BlackBox::start(&node, options, shutdown.as_fd()).unwrap();
    let talker = domain.node("talker");
    let mut counter = Counter::new(&talker);
    counter.wait_for_link(&mut black_box);
    let mut expect = |reason: &str| {
        let mut found = None;
        run(&mut black_box, &mut counter, |step| {
            if let BlackBoxStep::Triggered(reason, path) = step {
                found = Some((reason, path));
            }
            found.is_some()
        });
        let (found, path) = found.unwrap();
        assert_eq!(found, reason);
        path
    };

    let alarm = talker.publisher::<str>("alarm").unwrap();
    alarm.wait_for_subscribers_timeout(1, SOON).unwrap();
    alarm.publish("fire").unwrap();
    expect("message of alarm");

    drop(victim);
    expect("lost node victim");

    let heartbeat = talker.publisher::<u8>("heartbeat").unwrap();
    heartbeat.wait_for_subscribers_timeout(1, SOON).unwrap();
    heartbeat.publish(&1).unwrap();
    expect("missed deadline of heartbeat");

    let client = talker.client::<str, str>("record/trigger").unwrap();
    let calling = thread::spawn(move || client.call_timeout("collision", SOON).unwrap().to_owned());
    let path = expect("collision");
    while !calling.is_finished() {
        black_box.step(Duration::from_millis(10)).unwrap();
    }
    assert_eq!(calling.join().unwrap(), path.display().to_string());

    let incidents = black_box.finish().unwrap();
    let reasons: Vec<_> = incidents.iter().map(|it| it.reason.as_str()).collect();
    assert!(reasons.contains(&"collision"), "{reasons:?}");
    assert!(incidents.iter().all(|it| it.result.is_ok()));
}
