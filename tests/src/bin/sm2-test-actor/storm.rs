//! `storm --role ROLE`: a node that works without pause while its peers are killed at random times.
//! Any error other than the death of a peer is a panic.
//!
//! It follows the lines of standard input, in this order:
//!
//! | line | action | answer |
//! | --- | --- | --- |
//! | | connects | `connected` |
//! | `go` | declares its interface, and works | `working` |
//! | `stop [N]` | ends the work; a subscriber first waits for publication N of the survivor | a report |
//! | `close` | withdraws its interface, and then only drives its node | `closed` |
//!
//! With `--go true` it does not wait for `go`. A server with the role `holder` takes one request, answers the line
//! `holding`, and never replies.

use std::{
    collections::{HashMap, VecDeque},
    os::fd::AsFd,
    process::ExitCode,
    thread,
    time::Duration,
};

use sm2_node::{CallError, Node, Sample};
use sm2_tests::{TIMEOUT, input::Input, options::Options, pattern, random::Random};

/// The node whose messages must all arrive.
const SURVIVOR: &str = "survivor-pub";
/// The sizes of messages, from an empty one to one that needs its own segment.
const SIZES: [usize; 6] = [0, 1, 1_000, 5_000, 70_000, 300_000];
const PAUSE: Duration = Duration::from_micros(300);

/// The number of calls that a client has in flight.
const CALLS: usize = 4;

pub(crate) fn run(options: &Options) -> ExitCode {
    let name: String = options.get("--name").expect("--name");
    let socket: String = options.get("--socket").expect("--socket");
    let builder = Node::builder(&name).socket(socket).manager_timeout(TIMEOUT);
    let node = builder.connect().expect("a session");
    let mut control = Control {
        input: Input::new(),
        random: Random::new(options.get_or("--seed", 1)),
    };
    println!("connected");
    if !options.get_or("--go", false) {
        control.idle(&node, "go");
    }
    let role: String = options.get("--role").expect("--role");
    match role.as_str() {
        "pub" => publish(&node, &mut control),
        "sub" => subscribe(&node, &mut control),
        "server" => serve(&node, &mut control),
        "holder" => hold(&node),
        "client" => call(&node, &mut control),
        other => panic!("no role {other:?}"),
    }
    println!("closed");
    control.idle(&node, "never");
    ExitCode::SUCCESS
}

struct Control {
    input: Input,
    random: Random,
}

impl Control {
    /// Returns the text behind `word`, if a line with `word` has arrived.
    fn heard(&mut self, word: &str) -> Option<String> {
        let Ok(lines) = self.input.lines() else {
            std::process::exit(0);
        };
        let line = lines.into_iter().next()?;
        let rest = line.strip_prefix(word);
        let rest = rest.unwrap_or_else(|| panic!("{word} expected: {line}"));
        Some(rest.trim().to_owned())
    }

    fn message(&mut self, number: u64) -> Vec<u8> {
        pattern::message(number, self.random.choose(&SIZES))
    }

    /// Only drives the node, until the line `word` arrives.
    fn idle(&mut self, node: &Node, word: &str) {
        self.drain(node, word, || {});
    }

    /// Drives the node and calls `take` until the line `word` arrives: messages of dead peers keep
    /// memory until they are taken and dropped.
    fn drain(&mut self, node: &Node, word: &str, take: impl Fn()) {
        while self.heard(word).is_none() {
            take();
            let both = [self.input.as_fd(), node.as_fd()];
            sm2_io::wait_readable(&both, None).expect("poll");
            node.spin_some().expect("the node's own wait");
        }
    }
}

fn publish(node: &Node, control: &mut Control) {
    let builder = node.publisher_builder::<[u8]>("storm").depth(16);
    let publisher = builder
        .reliable(true)
        .publish_timeout(TIMEOUT)
        .declare()
        .expect("a publisher");
    let linked = publisher.wait_for_subscribers_timeout(1, TIMEOUT);
    linked.expect("a subscriber");
    println!("working");
    let mut published = 0;
    while control.heard("stop").is_none() {
        published += 1;
        let message = control.message(published);
        let result = publisher.publish(&message).expect("published");
        // The publisher does not wait for subscribers that have died.
        assert_eq!(result.missed, 0, "publication {published}");
        thread::sleep(PAUSE);
    }
    let counters = publisher.counters();
    let dropped = counters.dropped();
    let sum = counters.delivered + dropped + counters.in_flight;
    assert_eq!(counters.offered, sum, "{counters:?}");
    println!("published={published} {counters:?}");
    control.idle(node, "close");
}

fn subscribe(node: &Node, control: &mut Control) {
    let builder = node.subscriber_builder::<[u8]>("storm").depth(16);
    let subscriber = builder.reliable(true).declare().expect("a subscriber");
    println!("working");
    let mut last: HashMap<String, u64> = HashMap::new();
    let mut until = None;
    let mut received = 0_u64;
    while until.is_none_or(|until| last.get(SURVIVOR).copied().unwrap_or(0) < until) {
        if let Some(stop) = control.heard("stop") {
            until = Some(stop.parse().expect("a number"));
        }
        let wait = Duration::from_millis(20);
        if let Some(sample) = subscriber.recv_timeout(wait).expect("received") {
            check(&sample, &mut last);
            received += 1;
        }
    }
    println!("received={received} last={}", until.unwrap_or(0));
    control.drain(node, "close", || {
        while let Ok(Some(_)) = subscriber.try_recv() {}
    });
}

/// Asserts that every byte is right, and that no message of a living publisher is lost.
fn check(sample: &Sample<[u8]>, last: &mut HashMap<String, u64>) {
    let (number, publisher) = (sample.sequence(), sample.publisher().as_str());
    assert!(
        pattern::is_intact(sample, number),
        "{publisher}: message {number}"
    );
    assert_eq!(sample.lost(), 0, "{publisher}: before message {number}");
    let before = last.insert(publisher.to_owned(), number);
    if publisher == SURVIVOR && before.is_some() {
        assert_eq!(before, Some(number - 1), "{publisher}");
    }
}

fn serve(node: &Node, control: &mut Control) {
    let server = node.server::<[u8], [u8]>("storm").expect("a server");
    println!("working");
    let mut served = 0_u64;
    while control.heard("stop").is_none() {
        let wait = Duration::from_millis(20);
        let Some(request) = server.recv_timeout(wait).expect("received") else {
            continue;
        };
        let reply = request.to_vec();
        // A client that died needs no reply.
        let _ = request.reply(&reply);
        served += 1;
    }
    println!("served={served}");
    control.drain(
        node,
        "close",
        || while let Ok(Some(_)) = server.try_recv() {},
    );
}

/// Takes a request, and keeps it without a reply.
fn hold(node: &Node) {
    let server = node.server::<[u8], [u8]>("storm").expect("a server");
    println!("working");
    let request = server.recv_timeout(TIMEOUT).expect("received");
    let _held = request.expect("a request");
    println!("holding");
    loop {
        node.spin_once_timeout(TIMEOUT)
            .expect("the node's own wait");
    }
}

fn call(node: &Node, control: &mut Control) {
    let client = node.client::<[u8], [u8]>("storm").expect("a client");
    client
        .wait_for_servers_timeout(1, TIMEOUT)
        .expect("a server");
    println!("working");
    let (mut replied, mut failed) = (0_u64, 0_u64);
    let mut calls = VecDeque::new();
    for number in 0.. {
        let request = control.message(number);
        let call = client.send_timeout(&request, TIMEOUT);
        calls.push_back((request, call.expect("a server that lives")));
        let stopped = control.heard("stop").is_some();
        // Each call goes to the server with the fewest calls in flight, so that all servers get some.
        while calls.len() >= CALLS || (stopped && !calls.is_empty()) {
            let (request, call) = calls.pop_front().expect("a call");
            match call.wait() {
                Ok(reply) => {
                    assert!(*reply == *request, "reply {number}");
                    replied += 1;
                }
                // Reported at once, before the timeout of the call.
                Err(CallError::ServerGone { .. }) => failed += 1,
                Err(error) => panic!("call {number}: {error:?}"),
            }
        }
        if stopped {
            break;
        }
        thread::sleep(PAUSE);
    }
    println!("replied={replied} failed={failed}");
    control.idle(node, "close");
}
