//! Processes that attack a domain without a break, until they are killed. Each says `ready` when it begins.

use std::{
    os::fd::{AsFd, OwnedFd},
    path::{Path, PathBuf},
    process::ExitCode,
    thread,
    time::Duration,
};

use sm2_io::{SendError, SeqPacket};
use sm2_node::{Node, Publisher, Sample, Subscriber};
use sm2_tests::{
    control::{self, Qos},
    input::abort_at_end,
    memory,
    options::Options,
    raw::RawNode,
};

use crate::{hostile_links, victims::TOPIC};

/// More than a process may have: further ones are refused.
const SESSIONS: usize = 600;
/// The greatest number of descriptors in a datagram.
const DESCRIPTORS: usize = 253;
/// The matches of each declaration of the churn, by one node and by many.
const MATCHES: u64 = 1_000;
const MATCHES_OF_MANY: u64 = 80;

/// Runs the role `--role`.
pub(crate) fn run(options: &Options) -> ExitCode {
    abort_at_end();
    let socket: PathBuf = options.get("--socket").expect("--socket");
    let role: String = options.get("--role").expect("--role");
    let number: u32 = options.get_or("--number", 0);
    let name = format!("{role}/{number}");
    match role.as_str() {
        "violator" => hostile_links::violator(&socket, &name),
        "sparse-files" => hostile_links::sparse_files(&socket, &name),
        "sparse-segments" => hostile_links::sparse_segments(&socket, &name),
        "descriptors" => descriptors(&socket),
        "connections" => connections(&socket),
        "sessions" => sessions(&socket),
        "churn" => churn(&socket, &name, MATCHES),
        "busy" => churn(&socket, &name, MATCHES_OF_MANY),
        "deaf" => deaf(&socket, &name),
        role => library(role, &socket, &name),
    }
    ExitCode::SUCCESS
}

/// HELLO with as many descriptors as a datagram can carry, on ever new connections.
fn descriptors(socket: &Path) {
    let nulls: Vec<OwnedFd> = (0..DESCRIPTORS).map(|_| memory::null()).collect();
    let nulls: Vec<_> = nulls.iter().map(AsFd::as_fd).collect();
    println!("ready");
    loop {
        let node = RawNode::connect(socket);
        for _ in 0..3 {
            match node.peer().try_send(&control::hello("flood"), &nulls) {
                Ok(()) | Err(SendError::Closed | SendError::WouldBlock) => {}
                Err(error) => panic!("{error}"),
            }
        }
    }
}

/// Connections that close at once.
fn connections(socket: &Path) {
    println!("ready");
    loop {
        // The backlog may be full.
        if SeqPacket::connect(socket).is_err() {
            thread::yield_now();
        }
    }
}

/// As many sessions as the Manager grants, and connections that never greet.
fn sessions(socket: &Path) {
    let mut all = Vec::new();
    for number in 0..SESSIONS {
        let node = RawNode::connect(socket);
        // The Manager may hang up.
        let _ = (node.peer()).try_send(&control::hello(format!("silent/{number}")), &[]);
        drop(node.peer().next_frame());
        all.push(node);
    }
    println!("ready");
    loop {
        let connections = (0..DESCRIPTORS).map(|_| SeqPacket::connect(socket));
        let connections: Vec<_> = connections.collect();
        thread::sleep(Duration::from_millis(500));
        drop(connections);
    }
}

/// Declarations that each match many subscribers of a topic of its own, and their withdrawal.
fn churn(socket: &Path, name: &str, matches: u64) {
    let demanding = RawNode::welcomed(socket, &format!("{name}/demanding"));
    for interface in 1..=matches {
        demanding.declare(interface, &control::subscriber(name, Qos::PLAIN));
    }
    // The links are ended as soon as they are made.
    thread::spawn(move || while demanding.peer().next_frame().is_some() {});
    let offering = RawNode::welcomed(socket, &format!("{name}/offering"));
    println!("ready");
    for interface in 1.. {
        offering.send(control::declare(
            interface,
            &control::publisher(name, Qos::PLAIN),
        ));
        offering.send(control::withdraw(interface));
        while offering.peer().try_recv().is_some() {}
    }
}

/// Questions whose answers nobody reads, until the Manager ends the session; then again.
fn deaf(socket: &Path, name: &str) {
    println!("ready");
    for session in 0.. {
        let node = RawNode::welcomed(socket, &format!("{name}/{session}"));
        while !matches!(
            node.peer().try_send(&control::query(), &[]),
            Err(SendError::Closed)
        ) {}
    }
}

/// Nodes of the library that do nothing further: they hold what they get, or are stopped from outside.
fn library(role: &str, socket: &Path, name: &str) {
    let node = Node::builder(name).socket(socket).connect();
    let node = node.expect("a session");
    if role == "publisher" {
        let publisher: Publisher<[u8]> = node.publisher(TOPIC).expect("a publisher");
        let linked = publisher.wait_for_subscribers_timeout(1, sm2_tests::TIMEOUT);
        linked.expect("a subscriber");
        println!("ready");
        loop {
            publisher.publish(&[0; 200]).expect("published");
            thread::sleep(Duration::from_millis(5));
        }
    }
    let builder = node.subscriber_builder::<[u8]>(TOPIC).max_borrowed(64);
    let subscriber = builder.reliable(role == "reliable").declare();
    let subscriber: Subscriber<[u8]> = subscriber.expect("a subscriber");
    let mut held: Vec<Sample<[u8]>> = Vec::new();
    held.extend(
        subscriber
            .recv_timeout(sm2_tests::TIMEOUT)
            .expect("received"),
    );
    println!("ready");
    loop {
        match subscriber.recv_timeout(Duration::from_millis(100)) {
            Ok(Some(sample)) if role == "hoarder" => held.push(sample),
            Ok(_) => {}
            // It holds all that it may.
            Err(_) => thread::sleep(Duration::from_millis(10)),
        }
    }
}
