//! Domains without a daemon: nodes that embed a Manager.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::common::{SOON, back, next, until};
use sm2_manager::Options;
use sm2_node::Node;

fn node(name: &str, socket: &Path) -> Node {
    let builder = Node::builder(name).socket(socket);
    let builder = builder.embed_manager(Options::default());
    let builder = builder.manager_timeout(SOON);
    builder.startup_timeout(SOON).connect().unwrap()
}

/// A node without a Manager of its own.
fn plain(name: &str, socket: &Path) -> Node {
    let builder = Node::builder(name).socket(socket);
    builder.manager_timeout(SOON).connect().unwrap()
}

#[test]
fn the_first_node_brings_the_manager_and_the_second_takes_over() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("test.sock");
    let first = node("first", &socket);
    let second = node("second", &socket);
    let plain = plain("plain", &socket);
    let publisher = plain.publisher::<str>("topic").unwrap();
    let subscriber = second.subscriber::<str>("topic").unwrap();
    let epoch = second.epoch();
    assert!(epoch.is_some() && epoch == first.epoch());
    drop(first);
    until(|| (second.epoch() != epoch) & (plain.epoch() != epoch));
    back(&[&second, &plain]);
    until(|| {
        publisher.links().iter().any(|it| it.open) & subscriber.links().iter().any(|it| it.open)
    });
    publisher.publish("still here").unwrap();
    assert_eq!(&*next(&subscriber), "still here");
    assert_eq!(publisher.links().len(), 1);
    // The Manager ends together with the last node of its process.
    drop((subscriber, second));
    until(|| !plain.is_connected());
    assert!(Node::builder("late").socket(&socket).connect().is_err());
}

const SOCKET: &str = "SM2_TEST_EMBEDDED_SOCKET";

/// The process that the test below kills.
#[test]
fn a_process_with_a_manager() {
    let Some(socket) = std::env::var_os(SOCKET) else {
        return;
    };
    let node = node("first", Path::new(&socket));
    let publisher = node.publisher::<u64>("elsewhere").unwrap();
    println!("\nready");
    loop {
        publisher.publish(&1).unwrap();
        node.spin_for(Duration::from_millis(5)).unwrap();
    }
}

/// A process that is killed when dropped.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

//= SM2-NOD-003, SM2-RES-001 test
#[test]
fn when_the_process_of_the_manager_is_killed_another_takes_over() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("test.sock");
    let mut process = Command::new(std::env::current_exe().unwrap())
        .args([
            "--exact",
            "embedded::a_process_with_a_manager",
            "--nocapture",
        ])
        .env(SOCKET, &socket)
        .stdout(Stdio::piped())
        .spawn()
        .map(Killed)
        .unwrap();
    let output = BufReader::new(process.0.stdout.take().unwrap());
    let mut lines = output.lines().map(Result::unwrap);
    assert!(lines.any(|line| line == "ready"));
    let second = node("second", &socket);
    let other = plain("other", &socket);
    let publisher = second.publisher::<u64>("topic").unwrap();
    let subscriber = other.subscriber::<u64>("topic").unwrap();
    until(|| {
        publisher.links().iter().any(|it| it.open) & subscriber.links().iter().any(|it| it.open)
    });
    let epoch = second.epoch();
    drop(process);
    for number in 0..100 {
        publisher.publish(&number).unwrap();
        assert_eq!(*next(&subscriber), number);
    }
    until(|| (second.epoch() != epoch) & (other.epoch() != epoch));
    back(&[&second, &other]);
    for number in 0..100 {
        publisher.publish(&number).unwrap();
        assert_eq!(*next(&subscriber), number);
    }
    assert_eq!((publisher.links().len(), subscriber.links().len()), (1, 1));
    // The name of the killed node is free.
    let first = node("first", &socket);
    assert_eq!(first.epoch(), second.epoch());
}
