//! A black box keeps what was before a trigger, and what comes soon after it.

use std::fs::{self, File};
use std::io;
use std::os::fd::AsFd;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use sm2_bag::{
    Bag, BlackBox, BlackBoxOptions, BlackBoxStep, Filter, GapReason, Incident, Options, Trigger,
    check,
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

/// The options of a black box whose incidents end with it.
fn never_over(domain: &Domain) -> BlackBoxOptions {
    BlackBoxOptions {
        after: Duration::from_secs(3_600),
        ..options(domain, Duration::from_secs(60), Vec::new())
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

/// A black box, and a publisher that is linked to it.
fn linked<'a>(
    domain: &Domain,
    options: BlackBoxOptions,
    stop: &'a Shutdown,
) -> (BlackBox<'a>, Counter) {
    let node = domain.node("recorder");
    let mut black_box = BlackBox::start(&node, options, stop.as_fd()).unwrap();
    let counter = Counter::new(&domain.node("talker"));
    counter.wait_for_link(&mut black_box);
    (black_box, counter)
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
    let (mut black_box, mut counter) = linked(&domain, options, &shutdown);
    let mut incidents = Vec::new();
    tick(&mut black_box, &mut counter, 60, &mut incidents);
    let (first, _) = black_box.trigger("first");
    tick(&mut black_box, &mut counter, 1, &mut incidents);
    let (second, _) = black_box.trigger("second");
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
    let shutdown = Shutdown::new().unwrap();
    let (mut black_box, mut counter) = linked(&domain, never_over(&domain), &shutdown);
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
    let shutdown = Shutdown::new().unwrap();
    let victim = domain.node("victim");
    let triggers = vec![
        Trigger::Message(name("alarm")),
        Trigger::Service(name("record/trigger")),
        Trigger::LostNode(name("victim")),
        Trigger::MissedDeadline(name("heartbeat"), Duration::from_millis(50)),
    ];
    let options = options(&domain, Duration::from_secs(60), triggers);
    let (mut black_box, mut counter) = linked(&domain, options, &shutdown);
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

    let talker = domain.node("alarms");
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

/// Every process of a domain can trigger as often as it likes.
#[test]
fn too_many_triggers_are_merged_into_an_incident() {
    let domain = Domain::new();
    let shutdown = Shutdown::new().unwrap();
    let (mut black_box, mut counter) = linked(&domain, never_over(&domain), &shutdown);
    counter.publish();
    counter.wait_until_written(&mut black_box, &mut Vec::new());
    let mut paths: Vec<_> = (0..100).map(|_| black_box.trigger("flood")).collect();
    // The answer to each call names the bag with its time.
    let merged = paths.iter().filter(|it| it.1).count();
    assert_eq!(merged, 92);
    assert!(paths[8..].iter().all(|it| it.0 == paths[7].0));
    paths.dedup();
    let incidents = black_box.finish().unwrap();
    let counts: Vec<_> = incidents.iter().map(|it| it.merged).collect();
    assert_eq!(counts, [0, 0, 0, 0, 0, 0, 0, 92]);
    for incident in incidents {
        assert_eq!(written(incident), [0]);
    }
}

/// The room on the disk of the next test, in bytes.
static FREE: AtomicU64 = AtomicU64::new(u64::MAX);

fn free_bytes(_: &File) -> io::Result<u64> {
    Ok(FREE.load(Ordering::SeqCst))
}

#[test]
fn a_full_disk_costs_messages_and_incidents_wait_for_room() {
    let domain = Domain::new();
    let shutdown = Shutdown::new().unwrap();
    let mut options = BlackBoxOptions {
        after: Duration::ZERO,
        ..options(&domain, Duration::from_secs(600), Vec::new())
    };
    options.record.free_bytes = free_bytes;
    let (mut black_box, mut counter) = linked(&domain, options, &shutdown);
    for _ in 0..5 {
        counter.publish();
    }
    counter.wait_until_written(&mut black_box, &mut Vec::new());
    FREE.store(0, Ordering::SeqCst);
    let (path, _) = black_box.trigger("before");
    let mut waits = false;
    until("the incident waits for room", || {
        match black_box.step(Duration::from_millis(5)).unwrap() {
            BlackBoxStep::NoRoom(its) => waits = its == path,
            BlackBoxStep::Written(incident) => panic!("{incident:?}"),
            _ => {}
        }
        waits
    });
    // The writer looks at the disk when it has written something.
    until("messages are dropped", || {
        counter.publish();
        black_box.step(Duration::from_millis(5)).unwrap();
        black_box.progress().is_disk_full && black_box.progress().lost > 3
    });
    assert_eq!(fs::metadata(&path).unwrap().len(), 0);
    FREE.store(u64::MAX, Ordering::SeqCst);
    let mut incidents = Vec::new();
    until("there is room again", || {
        incidents.extend(complete(&mut black_box));
        !black_box.progress().is_disk_full && incidents.len() == 1
    });
    assert_eq!(incidents[0].path, path);
    assert_eq!(written(incidents.remove(0))[..5], [0, 1, 2, 3, 4]);
    counter.publish();
    until("the last number is written", || {
        black_box.step(Duration::from_millis(5)).unwrap();
        black_box.progress().messages + black_box.progress().lost == counter.next
    });
    black_box.trigger("after");
    let incident = black_box.finish().unwrap().remove(0);
    let report = incident.result.unwrap();
    let topic = &report.topics[0];
    assert_eq!(topic.messages + topic.lost, counter.next);
    assert_eq!(topic.gaps.len(), 1, "{:?}", topic.gaps);
    assert_eq!(topic.gaps[0].reason, GapReason::DiskFull);
}
