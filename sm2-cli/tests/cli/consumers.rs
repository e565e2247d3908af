//! Consumers that hang, are slow, hold their samples or are stopped, as every tool shows them.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use nix::sys::signal::Signal;
use serde_json::Value;
use sm2_node::Subscriber;

use crate::common::{Domain, SOON, listener, until};

/// The time between two messages of a [`Talker`].
const PERIOD: Duration = Duration::from_millis(5);

/// Something that a thread repeats until this value is dropped.
struct Repeat {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Repeat {
    fn new(mut step: impl FnMut() + Send + 'static) -> Self {
        let ends = Arc::new(AtomicBool::new(false));
        let end = Arc::clone(&ends);
        let thread = thread::spawn(move || {
            while !end.load(Ordering::Relaxed) {
                step();
            }
        });
        Self {
            ends,
            thread: Some(thread),
        }
    }
}

impl Drop for Repeat {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(ended.is_none_or(|it| it.is_ok()) || thread::panicking());
    }
}

/// The node `talker`, which publishes on `scan` all the time.
fn talker(domain: &Domain) -> Repeat {
    let publisher = domain.node("talker").publisher::<[u8]>("scan").unwrap();
    Repeat::new(move || {
        publisher.publish(&[b'.'; 200]).unwrap();
        thread::sleep(PERIOD);
    })
}

/// A subscriber of `scan` of the node `ear`.
fn ear(domain: &Domain, depth: u16, max_borrowed: u16) -> Subscriber<[u8]> {
    let node = domain.node("ear");
    let builder = node.subscriber_builder::<[u8]>("scan");
    let builder = builder.depth(depth).max_borrowed(max_borrowed);
    builder.declare().unwrap()
}

/// The JSON of `sm2 why talker:scan ear:scan`, once its exit status is this.
fn why(domain: &Domain, status: i32) -> Value {
    let mut json = String::new();
    until(&format!("the exit status of why is {status}"), || {
        let why = domain.run(&["why", "talker:scan", "ear:scan", "--json"]);
        json = why.stdout();
        why.code() == status
    });
    serde_json::from_str(&json).unwrap()
}

/// The rows of the topic `scan` and of a node in the tables of `sm2 top`, once they are as expected.
fn top(domain: &Domain, node: &str, is_so: impl Fn(&Value, &Value) -> bool) {
    until("the rows of top are as expected", || {
        let tables = domain.json(&["top", "--interval", "200ms"]);
        let row = |table: &str, name: &str| {
            let mut rows = tables[table].as_array().unwrap().iter();
            rows.find(|it| it["name"] == name)
                .cloned()
                .unwrap_or_default()
        };
        is_so(&row("topics", "scan"), &row("nodes", node))
    });
}

/// The finding of a check of `sm2 doctor`, once its level is this.
fn doctor(domain: &Domain, check: &str, level: &str) -> String {
    let mut found = String::new();
    until(&format!("{check} is {level}"), || {
        let report = domain.json(&["doctor"]);
        let mut checks = report["checks"].as_array().unwrap().iter();
        let check = checks.find(|it| it["check"] == check).unwrap();
        found = format!("{}: {}", check["found"], check["advice"]);
        check["level"] == level
    });
    found
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

#[test]
fn a_consumer_that_hangs_is_seen() {
    let domain = Domain::new();
    let _subscriber = ear(&domain, 1, 1);
    let _talker = talker(&domain);
    let found = why(&domain, 3);
    assert_eq!(
        (&found["linked"], &found["working"]),
        (&true.into(), &false.into())
    );
    let end = &found["not_taking"][0];
    assert_eq!(
        (&end["interface"], &end["peer"]),
        (&"ear:scan".into(), &"talker:scan".into())
    );
    assert!(
        number(&end["seconds"]) >= 2.0 && number(&end["waiting"]) >= 1.0,
        "{end}"
    );
    assert_eq!(end["held"], 0);

    let text = domain.run(&["why", "talker", "ear"]).stdout();
    assert!(text.contains(" are linked.\n"), "{text}");
    let but = text.lines().find(|it| it.starts_with("But ")).unwrap();
    assert!(
        but.starts_with("But ear:scan has taken nothing for ")
            && but.contains(" s, while ")
            && but.contains(" of talker:scan wait")
            && but.ends_with(": see what its program does, with its log or a debugger."),
        "{but}"
    );
    let note = text
        .lines()
        .find(|it| it.starts_with("Note: ear:scan "))
        .unwrap();
    assert!(
        note.starts_with("Note: ear:scan did not get ")
            && note.contains(" messages/s of talker:scan in the last "),
        "{note}"
    );
}

#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn every_tool_names_a_consumer_that_hangs() {
    let domain = Domain::new();
    let _subscriber = ear(&domain, 1, 1);
    let _talker = talker(&domain);
    why(&domain, 3);
    let around = domain.run(&["why", "ear"]);
    assert_eq!(around.code(), 3, "{around:?}");
    assert!(
        around
            .stdout()
            .contains("But ear:scan has taken nothing for "),
        "{around:?}"
    );

    let found = doctor(&domain, "consumers", "warn");
    assert!(found.contains("ear:scan has taken nothing for "), "{found}");
    // Its losses follow from that, so they are not named again.
    assert!(doctor(&domain, "losses", "ok").contains("no message is being lost"));
    top(&domain, "ear", |topic, node| {
        [topic, node]
            .iter()
            .all(|it| number(&it["stalled_s"]) >= 2.0 && number(&it["lost_per_s"]) > 0.0)
    });
    let snapshot = domain.run(&["snapshot"]).stdout();
    let second = snapshot.lines().nth(1).unwrap();
    assert!(
        second.starts_with("But ear:scan has taken nothing for "),
        "{snapshot}"
    );
    let snapshot = domain.json(&["snapshot"]);
    assert_eq!(
        snapshot["troubles"]["not_taking"][0]["interface"],
        "ear:scan"
    );
}

/// A consumer that takes messages again works.
#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn a_consumer_that_no_longer_hangs_works() {
    let domain = Domain::new();
    let subscriber = ear(&domain, 1, 1);
    let _talker = talker(&domain);
    why(&domain, 3);
    let _taking = Repeat::new(move || drop(subscriber.recv_timeout(PERIOD).unwrap()));
    let found = why(&domain, 0);
    assert_eq!(
        (&found["working"], &found["not_taking"]),
        (&true.into(), &Value::Array(Vec::new()))
    );
    assert!(doctor(&domain, "consumers", "ok").contains("all take what waits"));
}

/// A slow consumer works, and its losses are shown.
#[test]
fn a_consumer_that_is_slow_is_seen() {
    let domain = Domain::new();
    let subscriber = ear(&domain, 1, 1);
    let _talker = talker(&domain);
    let _taking = Repeat::new(move || {
        drop(subscriber.recv_timeout(SOON).unwrap());
        thread::sleep(20 * PERIOD);
    });
    let mut text = String::new();
    until("losses are shown", || {
        let why = domain.run(&["why", "talker", "ear"]);
        text = why.stdout();
        why.code() == 0 && text.contains("Note: ear:scan did not get ")
    });
    assert!(!text.contains("But "), "{text}");
    let reason = "because its program does not take them in time: let the program do less";
    assert!(text.contains(reason), "{text}");
    let found = doctor(&domain, "losses", "warn");
    assert!(found.contains("ear:scan did not get "), "{found}");
    top(&domain, "ear", |topic, node| {
        let losing = [topic, node]
            .iter()
            .all(|it| number(&it["lost_per_s"]) > 0.0);
        losing && number(&topic["stalled_s"]) == 0.0 && number(&topic["lost"]) > 0.0
    });
}

#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn a_consumer_that_holds_all_its_samples_is_seen() {
    let domain = Domain::new();
    let subscriber = ear(&domain, 4, 2);
    let _talker = talker(&domain);
    let take = || subscriber.recv_timeout(SOON).unwrap().unwrap();
    let held = [take(), take()];
    let found = why(&domain, 3);
    let end = &found["not_taking"][0];
    assert_eq!((&end["held"], &end["max_held"]), (&2.into(), &2.into()));
    let found = doctor(&domain, "consumers", "warn");
    assert!(
        found.contains("; it holds 2 samples, which is all that it can hold")
            && found.contains("let its program drop samples"),
        "{found}"
    );
    top(&domain, "ear", |topic, node| {
        number(&topic["held"]) == 2.0 && number(&node["held"]) == 2.0
    });
    drop(held);
    top(&domain, "ear", |topic, _| number(&topic["held"]) == 0.0);
}

#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn a_consumer_that_is_stopped_is_seen() {
    let domain = Domain::new();
    let _talker = talker(&domain);
    let (echo, name) = listener(&domain, "scan", 1);
    echo.signal(Signal::SIGSTOP);
    let mut text = String::new();
    until("why sees that it takes nothing", || {
        let why = domain.run(&["why", "talker", &name]);
        text = why.stdout();
        why.code() == 3 && text.contains("has taken nothing for ")
    });
    assert!(text.contains(" is stopped by a signal"), "{text}");
    top(&domain, &name, |_, node| number(&node["stalled_s"]) >= 2.0);
    assert!(doctor(&domain, "stopped nodes", "warn").contains(&name));
    assert!(doctor(&domain, "consumers", "warn").contains(&name));
    echo.signal(Signal::SIGCONT);
    until("it works again", || {
        domain.run(&["why", "talker", &name]).code() == 0
    });
}

/// A publisher that hangs: its subscriber misses deadlines.
#[test]
fn a_deadline_that_is_being_missed_is_seen() {
    let domain = Domain::new();
    let (talker, node) = (domain.node("talker"), domain.node("ear"));
    let deadline = 10 * PERIOD;
    let publisher = talker.publisher_builder::<[u8]>("scan").deadline(deadline);
    let publisher = publisher.declare().unwrap();
    let subscriber = node.subscriber_builder::<[u8]>("scan").deadline(deadline);
    let subscriber = subscriber.declare().unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    publisher.publish(b"the last one").unwrap();
    drop(subscriber.recv_timeout(SOON).unwrap().unwrap());
    let found = why(&domain, 3);
    let missing = found["missing_deadlines"].as_array().unwrap();
    assert!(
        missing.iter().any(|it| it["interface"] == "ear:scan"),
        "{found}"
    );
    assert_eq!(found["not_taking"], Value::Array(Vec::new()), "{found}");
    let text = domain.run(&["why", "talker", "ear"]).stdout();
    assert!(
        text.contains("But ear:scan missed its deadline in "),
        "{text}"
    );
    let found = doctor(&domain, "deadlines", "warn");
    assert!(
        found.contains("missed its deadline") && found.contains("see `sm2 why "),
        "{found}"
    );
    top(&domain, "ear", |topic, node| {
        [topic, node]
            .iter()
            .all(|it| number(&it["missed_deadlines_per_s"]) > 0.0)
    });
    drop(publisher);
}

/// A figure of an earlier interval is marked. The processor time of a node's process is shown.
#[test]
fn old_delays_and_processor_times_are_shown() {
    let domain = Domain::new();
    let subscriber = ear(&domain, 1, 1);
    let talker = domain.node("talker");
    let publisher = talker.publisher::<[u8]>("scan").unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    publisher.publish(b"the last one").unwrap();
    drop(subscriber.recv_timeout(SOON).unwrap().unwrap());
    top(&domain, "ear", |topic, _| {
        topic["delay_p50_ms_old"] == true && topic["delay_p50_ms"].is_number()
    });
    let text = domain
        .run(&["top", "--once", "--interval", "20ms"])
        .stdout();
    let scan = text.lines().find(|it| it.starts_with("scan ")).unwrap();
    assert!(scan.contains(" (") && scan.contains(") "), "{text}");

    let _talking = Repeat::new(move || {
        publisher.publish(&[b'.'; 200]).unwrap();
        drop(subscriber.recv_timeout(SOON).unwrap());
    });
    top(&domain, "ear", |topic, node| {
        topic["delay_p50_ms_old"] == false && number(&node["cpu_percent"]) > 0.0
    });
}
