//! A bridge whose network takes nothing more: as if its router were stopped.

use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::channel;
use std::sync::{Arc, Condvar, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use crate::common::{Running, World, receive, wait_until};
use crate::program::Program;
use sm2_node::Publisher;
use sm2_test_support::{SOON, until};
use zenoh::Wait;

const MESSAGE_BYTES: usize = 1_000_000;
/// As many messages as have many times the memory that a bridge may use.
const MESSAGES: u32 = 500;
/// As many messages as fill the buffers of the operating system for a stalled link several times.
const PEER_MESSAGES: u32 = 40;
/// 64 MiB wait for the network, and as many messages of the network for the domain. The rest is that of the program
/// and of the pages that it shares with the publisher.
const MEMORY_MAX_KIB: u64 = 200 << 10;

/// A link between a bridge and a router that can be stalled.
struct Link {
    address: SocketAddr,
    /// How many connections there were.
    connections: Arc<Mutex<usize>>,
    is_stalled: Arc<(Mutex<bool>, Condvar)>,
}

impl Link {
    fn to(endpoint: &str) -> Self {
        let router: SocketAddr = endpoint.trim_start_matches("tcp/").parse().unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let is_stalled = Arc::new((Mutex::new(false), Condvar::new()));
        let its = Arc::clone(&is_stalled);
        let connections = Arc::new(Mutex::new(0));
        let count = Arc::clone(&connections);
        thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                *count.lock().unwrap() += 1;
                let router = TcpStream::connect(router).unwrap();
                let ends = [(&stream, &router), (&router, &stream)];
                for (from, to) in ends.map(|(a, b)| (a.try_clone(), b.try_clone())) {
                    let (from, to, its) = (from.unwrap(), to.unwrap(), Arc::clone(&its));
                    thread::spawn(move || carry(from, to, &its));
                }
            }
        });
        Self {
            address,
            connections,
            is_stalled,
        }
    }

    fn stall(&self, is_stalled: bool) {
        *self.is_stalled.0.lock().unwrap() = is_stalled;
        self.is_stalled.1.notify_all();
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, is_stalled: &(Mutex<bool>, Condvar)) {
    let mut bytes = vec![0; 64 << 10];
    loop {
        let stalled = is_stalled.0.lock().unwrap();
        drop(is_stalled.1.wait_while(stalled, |it| *it).unwrap());
        match from.read(&mut bytes) {
            Ok(len) if len > 0 && to.write_all(&bytes[..len]).is_ok() => {}
            _ => return,
        }
    }
}

/// Publishes a message, which a local subscriber gets.
fn publish(publisher: &Publisher<[u8]>, local: &sm2_node::Subscriber<[u8]>, number: u32) {
    let mut message = vec![7; MESSAGE_BYTES];
    message[..4].copy_from_slice(&number.to_le_bytes());
    publisher.publish(&message).unwrap();
    assert!(receive(local) == message, "message {number}");
}

/// A peer sends each message to all its links in turn.
#[test]
fn the_other_links_of_a_peer_go_on_while_one_is_stalled() {
    let (stalled, site) = (World::new(), World::new());
    let link = Link::to(&stalled.endpoint);
    let (sender, arrived) = channel();
    for (network, is_site) in [(&stalled.network, false), (&site.network, true)] {
        let sender = sender.clone();
        let subscriber = network.declare_subscriber("sm2/image");
        let subscriber = subscriber.callback(move |sample| {
            let number = sample.payload().to_bytes()[..4].try_into().unwrap();
            let _ = sender.send((is_site, u32::from_le_bytes(number)));
        });
        subscriber.background().wait().unwrap();
    }
    let rules = "[[rule]]\naction = \"allow\"\nnames = \"image\"\ndirection = \"out\"\n";
    let endpoints = format!("tcp/{}\", \"{}", link.address, site.endpoint);
    let config = site.config_of("peer", "name = \"seven\"", &endpoints, rules);
    let bridge = Running::start(&config);
    let (camera, viewer) = (site.node("camera"), site.node("viewer"));
    let local = viewer.subscriber::<[u8]>("image").unwrap();
    let publisher = camera.publisher::<[u8]>("image").unwrap();
    publisher.wait_for_subscribers_timeout(2, SOON).unwrap();
    let mut number = 0;
    let mut sides = BTreeSet::new();
    wait_until(|| {
        number += 1;
        publish(&publisher, &local, number);
        sides.extend(arrived.try_iter().map(|(is_site, _)| is_site));
        sides.len() == 2
    });

    link.stall(true);
    let mut longest = Duration::ZERO;
    for number in number + 1..=number + PEER_MESSAGES {
        let start = Instant::now();
        publish(&publisher, &local, number);
        while arrived.recv_timeout(SOON).unwrap() != (true, number) {}
        longest = longest.max(start.elapsed());
    }
    println!(
        "{PEER_MESSAGES} messages of 1 MB to two links, one of them stalled: at most {longest:?} until the other one \
         had a message"
    );
    link.stall(false);
    bridge.end();
}

#[test]
fn a_stalled_network_costs_no_local_message_and_little_memory() {
    let world = World::new();
    let link = Link::to(&world.endpoint);
    let (sender, arrived) = channel();
    let subscriber = world.network.declare_subscriber("sm2/image");
    let subscriber = subscriber.callback(move |sample| {
        let number = sample.payload().to_bytes()[..4].try_into().unwrap();
        let _ = sender.send(u32::from_le_bytes(number));
    });
    subscriber.background().wait().unwrap();
    let rules = "[[rule]]\naction = \"allow\"\nnames = \"image\"\ndirection = \"out\"\n";
    let endpoint = format!("tcp/{}", link.address);
    let file = world.write_config("name = \"seven\"", &endpoint, rules);
    let bridge = Program::start(&file, &[]);

    let (camera, viewer) = (world.node("camera"), world.node("viewer"));
    let local = viewer.subscriber::<[u8]>("image").unwrap();
    let publisher = camera.publisher::<[u8]>("image").unwrap();
    publisher.wait_for_subscribers_timeout(2, SOON).unwrap();
    publish(&publisher, &local, 0);
    assert_eq!(arrived.recv_timeout(SOON), Ok(0));

    link.stall(true);
    for number in 1..=MESSAGES {
        publish(&publisher, &local, number);
    }
    until("the bridge drops the oldest messages", || {
        bridge.count("superseded") > 0
    });
    let (sent, superseded) = (bridge.count("sent"), bridge.count("superseded"));
    let peak_kib = bridge.peak_kib();
    println!(
        "{MESSAGES} messages of 1 MB into a stalled network: {sent} sent, {superseded} superseded, peak memory of the \
         bridge (VmHWM) {peak_kib} KiB"
    );
    assert!(peak_kib < MEMORY_MAX_KIB, "{peak_kib} KiB");

    // Zenoh takes the link for dead, and closes it.
    until("the bridge connects again", || {
        *link.connections.lock().unwrap() > 1
    });
    link.stall(false);
    let mut number = MESSAGES;
    wait_until(|| {
        number += 1;
        publish(&publisher, &local, number);
        arrived.try_iter().any(|it| it > MESSAGES)
    });
    let summary = bridge.end();
    assert!(summary.contains(" superseded, "), "{summary}");
}
