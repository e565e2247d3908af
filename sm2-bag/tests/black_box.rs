//! A black box keeps what was before a trigger, and what comes soon after it.

use std::fs;
use std::os::fd::AsFd;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use sm2_bag::{
    Bag, BlackBox, BlackBoxOptions, BlackBoxStep, Filter, Incident, Options, Trigger, check,
};
use sm2_node::clock::DomainTime;
use sm2_node::{Name, Node, Publisher, Shutdown};
use sm2_proto::Instant;

use crate::common::{Domain, SOON, named, until};

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

    /// Steps until the black box has written all numbers. Adds the incidents that are complete.
    fn wait_until_written(&self, black_box: &mut BlackBox<'_>, incidents: &mut Vec<Incident>) {
        until("all numbers are written", || {
            incidents.extend(complete(black_box));
            black_box.progress().messages == self.next
        });
    }

    fn wait_for_link(&self, black_box: &mut BlackBox<'_>) {
        until("the black box is linked", || {
            black_box.step(Duration::from_millis(5)).unwrap();
            self.publisher.links().iter().any(|it| it.open)
        });
    }
}

/// Publishes a number every 10 ms or sooner until `done` returns true for a step.
fn run(
    black_box: &mut BlackBox<'_>,
    counter: &mut Counter,
    mut done: impl FnMut(BlackBoxStep) -> bool,
) {
    until("something happens", || {
        counter.publish();
        done(black_box.step(Duration::from_millis(10)).unwrap())
    });
}

/// The numbers of a bag, which is complete. They are consecutive.
fn numbers(path: &Path) -> Vec<u64> {
    assert_eq!(check(path).unwrap().damages, []);
    let bag = Bag::open(path).unwrap();
    let messages = bag.messages(&Filter::default());
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

/// Steps. Returns an incident that is complete now.
fn complete(black_box: &mut BlackBox<'_>) -> Option<Incident> {
    match black_box.step(Duration::from_millis(5)).unwrap() {
        BlackBoxStep::Written(incident) => Some(incident),
        _ => None,
    }
}

/// A number is published each time the clock has moved on by this.
const TICK: Duration = Duration::from_millis(100);
/// The clocks of the black box, in nanoseconds. Only the test moves them.
static NOW_NS: AtomicU64 = AtomicU64::new(0);

fn wall_clock() -> DomainTime {
    DomainTime(NOW_NS.load(Ordering::SeqCst))
}

fn monotonic_clock() -> Instant {
    Instant(NOW_NS.load(Ordering::SeqCst))
}

/// Moves the clock on and publishes a number, as often as given.
fn tick(
    black_box: &mut BlackBox<'_>,
    counter: &mut Counter,
    ticks: u64,
    incidents: &mut Vec<Incident>,
) {
    for _ in 0..ticks {
        NOW_NS.fetch_add(TICK.as_nanos() as u64, Ordering::SeqCst);
        counter.publish();
        counter.wait_until_written(black_box, incidents);
    }
}

#[test]
fn overlapping_triggers_each_get_their_time() {
    let domain = Domain::new();
    let node = domain.node("recorder");
    let shutdown = Shutdown::new().unwrap();
    NOW_NS.store(sm2_io::clock::now().0, Ordering::SeqCst);
    // Windows that begin and end between two ticks.
    let mut options = BlackBoxOptions {
        after: 3 * TICK + TICK / 2,
        ..options(&domain, 24 * TICK + TICK / 2, Vec::new())
    };
    options.record.wall_clock = wall_clock;
    options.record.monotonic_clock = monotonic_clock;
    options.record.sync_interval = Duration::from_millis(1);
    let mut black_box = BlackBox::start(&node, options, shutdown.as_fd()).unwrap();
    let talker = domain.node("talker");
    let mut counter = Counter::new(&talker);
    counter.wait_for_link(&mut black_box);
    let mut incidents = Vec::new();
    tick(&mut black_box, &mut counter, 60, &mut incidents);
    let first = black_box.trigger("first");
    tick(&mut black_box, &mut counter, 1, &mut incidents);
    let second = black_box.trigger("second");
    assert_ne!(first, second);
    tick(&mut black_box, &mut counter, 2, &mut incidents);
    assert!(incidents.is_empty(), "{incidents:?}");
    tick(&mut black_box, &mut counter, 20, &mut incidents);
    until("both incidents are complete", || {
        incidents.extend(complete(&mut black_box));
        incidents.len() == 2
    });
    // Two threads write the bags, and either one may be done first.
    incidents.sort_by(|one, other| one.reason.cmp(&other.reason));
    for (incident, path, reason, at) in [
        (incidents.remove(0), first, "first", 60),
        (incidents.remove(0), second, "second", 61),
    ] {
        assert_eq!((&incident.path, incident.reason.as_str()), (&path, reason));
        let numbers = written(incident);
        assert!(
            numbers.iter().copied().eq(at - 25..at + 3),
            "{at}: {numbers:?}"
        );
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
    for _ in 0..20 {
        counter.publish();
        counter.wait_until_written(&mut black_box, &mut Vec::new());
    }
    black_box.trigger("end");
    let incidents = black_box.finish().unwrap();
    assert_eq!(incidents.len(), 1);
    for incident in incidents {
        assert!(written(incident).into_iter().eq(0..20));
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
        Trigger::MissedDeadline(name("heartbeat"), Duration::from_millis(50)),
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
    until("the call is answered", || {
        black_box.step(Duration::from_millis(10)).unwrap();
        calling.is_finished()
    });
    assert_eq!(calling.join().unwrap(), path.display().to_string());

    let incidents = black_box.finish().unwrap();
    let reasons: Vec<_> = incidents.iter().map(|it| it.reason.as_str()).collect();
    assert!(reasons.contains(&"collision"), "{reasons:?}");
    assert!(incidents.iter().all(|it| it.result.is_ok()));
}
