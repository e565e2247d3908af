//! The processes of `sm2 demo`, each with the test as its director and its peer.

use std::{
    io::Write,
    process::{ChildStdin, Stdio},
    thread,
    time::{Duration, Instant},
};

use serde_json::Value;
use sm2_node::{Node, Subscriber};

use crate::common::{Domain, Running, SOON, until};

/// The topic of the demo.
const TOPIC: &str = "demo";
const DEPTH: u16 = 8;
const LEN_BYTES: usize = 64;
/// The longest time that a publisher waits for the release of its messages.
const RELEASE_TIMEOUT: Duration = Duration::from_secs(5);

struct Part {
    process: Running,
    stdin: ChildStdin,
}

impl Part {
    fn start(domain: &Domain, role: &str, count: u64, period: Duration) -> Self {
        let (size, count) = (LEN_BYTES.to_string(), count.to_string());
        let period = period.as_nanos().to_string();
        let mut command = domain.command(&["demo-part", role, "--name", "part"]);
        command
            .args(["--size", &size, "--period", &period])
            .args(["--count", &count, "--subscribers", "1"])
            .stdin(Stdio::piped());
        let mut process = Running::start(&mut command);
        let stdin = process.child().stdin.take().unwrap();
        process.await_stdout("\"ready\"\n");
        Self { process, stdin }
    }

    /// The publisher of so many messages, after it was told to start.
    fn publisher(domain: &Domain, count: u64, period: Duration) -> Self {
        let mut part = Self::start(domain, "publisher", count, period);
        part.stdin.write_all(b"start\n").unwrap();
        part
    }

    /// The figures in its events of this name so far.
    fn figures(&self, event: &str) -> Vec<Value> {
        let stdout = self.process.stdout();
        let lines = stdout.split_inclusive('\n').filter(|it| it.ends_with('\n'));
        let events = lines.map(|it| serde_json::from_str::<Value>(it).unwrap());
        let figures = events.filter_map(|it| it.get(event).cloned());
        figures.collect()
    }

    fn is_done(&self) -> bool {
        !self.figures("done").is_empty()
    }

    /// Ends the process, which reports the figures of the whole run.
    fn end(self) -> Value {
        let Self { process, stdin } = self;
        drop(stdin);
        let finished = process.finish();
        assert_eq!(finished.code(), 0, "{finished:?}");
        let stdout = finished.stdout();
        let last: Value = serde_json::from_str(stdout.lines().last().unwrap()).unwrap();
        last["done"].clone()
    }
}

fn subscriber(node: &Node) -> Subscriber<[u8]> {
    let builder = node.subscriber_builder::<[u8]>(TOPIC);
    builder.depth(DEPTH).declare().unwrap()
}

/// A machine that stops for seconds can use up the timeout, so there are several attempts.
#[test]
fn a_publisher_is_done_when_its_messages_are_released() {
    let is_done_at_once = || {
        let domain = Domain::new();
        let node = domain.node("peer");
        let subscriber = subscriber(&node);
        let publisher = Part::publisher(&domain, 1, Duration::from_millis(1));
        let start = Instant::now();
        let sample = subscriber.recv_timeout(SOON).unwrap().expect("a message");
        thread::sleep(Duration::from_millis(300));
        let is_done = publisher.is_done();
        let late = start.elapsed() >= RELEASE_TIMEOUT;
        assert!(!is_done || late, "done before the message is released");
        drop(sample);
        until("the publisher is done", || publisher.is_done());
        let in_time = start.elapsed() < RELEASE_TIMEOUT;
        assert_eq!(publisher.end()["messages"], 1);
        in_time
    };
    assert!((0..5).any(|_| is_done_at_once()));
}

#[test]
fn a_publisher_ends_with_its_input() {
    const COUNT: u64 = 1_000_000;
    let domain = Domain::new();
    let node = domain.node("peer");
    let subscriber = subscriber(&node);
    let publisher = Part::publisher(&domain, COUNT, Duration::from_secs(1));
    let first = subscriber.recv_timeout(SOON).unwrap();
    drop(first.expect("a message"));
    let messages = publisher.end()["messages"].as_u64().unwrap();
    assert!((1..COUNT).contains(&messages), "{messages}");
}

#[test]
fn a_publisher_reports_once_a_second() {
    let domain = Domain::new();
    let node = domain.node("peer");
    let subscriber = subscriber(&node);
    let start = Instant::now();
    let publisher = Part::publisher(&domain, 20, Duration::from_millis(5));
    until("the publisher is done", || {
        while subscriber.try_recv().unwrap().is_some() {}
        publisher.is_done()
    });
    let reports = publisher.figures("progress").len() as u64;
    let time = start.elapsed();
    assert!(reports <= time.as_secs(), "{reports} reports in {time:?}");
    publisher.end();
}

#[test]
fn a_subscriber_reports_the_latency_of_the_last_second() {
    let domain = Domain::new();
    let subscriber = Part::start(&domain, "subscriber", 1, Duration::from_secs(1));
    let node = domain.node("peer");
    let builder = node.publisher_builder::<[u8]>(TOPIC);
    let publisher = builder.depth(DEPTH).declare().unwrap();
    let mut seconds = Vec::new();
    until("messages in a second", || {
        publisher.publish(&[0; LEN_BYTES]).unwrap();
        seconds = subscriber.figures("progress");
        seconds.retain(|it| it["hz"].as_f64() > Some(0.0));
        !seconds.is_empty()
    });
    let longest = seconds[0]["latency_us"]["max"].as_f64();
    assert!(longest > Some(0.0), "{seconds:?}");
    subscriber.end();
}
