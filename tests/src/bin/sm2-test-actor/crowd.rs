//! `crowd --first N --count N --total N`: many nodes in one process. Each publishes five topics
//! of its own, and subscribes to one topic of each of five others.
//!
//! Prints `declared`, `linked` and `passed` when all of its nodes have reached that stage. After
//! each, it continues when a line arrives on standard input.

use std::{os::fd::AsFd, process::ExitCode, thread, time::Duration};

use nix::sys::resource::{Resource, getrlimit, setrlimit};
use sm2_node::{Node, Publisher, Subscriber};

use sm2_tests::{TIMEOUT, input::Input, options::Options};

const TOPICS: usize = 5;

struct Member {
    node: Node,
    publishers: Vec<Publisher<[u8]>>,
    /// Each subscriber with the index of the node that it subscribes to.
    subscribers: Vec<(Subscriber<[u8]>, usize)>,
}

pub(crate) fn run(options: &Options) -> ExitCode {
    if let Ok((_, hard)) = getrlimit(Resource::RLIMIT_NOFILE) {
        setrlimit(Resource::RLIMIT_NOFILE, hard, hard).expect("more descriptors");
    }
    let number = |name| options.get::<usize>(name).expect("a number");
    let (first, total) = (number("--first"), number("--total"));
    let socket: String = options.get("--socket").expect("--socket");
    let all = first..first + number("--count");
    let crowd: Vec<Member> = all.map(|index| member(index, total, &socket)).collect();
    let mut input = Input::new();
    say(&crowd, &mut input, "declared");
    until(&crowd, |member| {
        let published = member.publishers.iter().map(Publisher::links);
        let heard = member.subscribers.iter().map(|(it, _)| it.links());
        published
            .chain(heard)
            .all(|links| links.iter().any(|link| link.open))
    });
    say(&crowd, &mut input, "linked");
    for (index, member) in (first..).zip(&crowd) {
        for publisher in &member.publishers {
            let took = publisher.publish(index.to_string().as_bytes());
            assert_eq!(took.expect("published").links, 1);
        }
    }
    receive(&crowd);
    say(&crowd, &mut input, "passed");
    ExitCode::SUCCESS
}

fn member(index: usize, total: usize, socket: &str) -> Member {
    let name = format!("crowd/{index}");
    let node = Node::builder(&name)
        .socket(socket)
        .manager_timeout(TIMEOUT)
        .connect()
        .expect("a session");
    let publish = |topic| {
        node.publisher::<[u8]>(&format!("{name}/{topic}"))
            .expect("a publisher")
    };
    let publishers = (0..TOPICS).map(publish).collect();
    let subscribe = |topic: usize| {
        // A distant node, and a different one for each topic.
        let other = (index + 1 + topic * 97) % total;
        let topic = format!("crowd/{other}/{topic}");
        (
            node.subscriber::<[u8]>(&topic).expect("a subscriber"),
            other,
        )
    };
    let subscribers = (0..TOPICS).map(subscribe).collect();
    Member {
        node,
        publishers,
        subscribers,
    }
}

/// Drives all nodes until `done` is true of each.
fn until(crowd: &[Member], done: impl Fn(&Member) -> bool) {
    let mut waiting: Vec<&Member> = crowd.iter().collect();
    while !waiting.is_empty() {
        drive(crowd);
        waiting.retain(|member| !done(member));
        thread::sleep(Duration::from_millis(1));
    }
}

fn drive(crowd: &[Member]) {
    for member in crowd {
        member.node.spin_some().expect("the node's own wait");
    }
}

/// Receives one message from each node that is subscribed to.
fn receive(crowd: &[Member]) {
    let mut missing: Vec<&(Subscriber<[u8]>, usize)> = crowd
        .iter()
        .flat_map(|member| &member.subscribers)
        .collect();
    while !missing.is_empty() {
        drive(crowd);
        missing.retain(|(subscriber, other)| {
            let sample = subscriber.try_recv().expect("received");
            if let Some(sample) = &sample {
                assert_eq!(**sample, *other.to_string().as_bytes());
            }
            sample.is_none()
        });
        thread::sleep(Duration::from_millis(1));
    }
}

/// Prints the stage that it has reached, and drives its nodes until a line arrives.
fn say(crowd: &[Member], input: &mut Input, word: &str) {
    println!("{word}");
    loop {
        drive(crowd);
        match input.lines() {
            Ok(lines) if lines.is_empty() => {}
            Ok(_) => return,
            Err(_) => std::process::exit(0),
        }
        let pause = Some(Duration::from_millis(1));
        sm2_io::wait_readable(&[input.as_fd()], pause).expect("poll");
    }
}
