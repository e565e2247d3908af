//! In an event loop, each descriptor is sufficient for its interface. (Complete programs with such loops are
//! examples: see `tests/examples.rs`.)

use std::time::Instant;

use crate::common::{Domain, SOON, until};
use sm2_io::{Epoll, Events, Interest};

const SERVER: u64 = 0;
const CLIENT: u64 = 1;
const PUBLISHER: u64 = 2;
const SUBSCRIBER: u64 = 3;

/// One loop for all four kinds of interfaces, each with its own node. A node is called only when its
/// descriptor is readable, and only as the table in the crate's documentation says.
#[test]
fn each_descriptor_is_enough() {
    let domain = Domain::new();
    let server = domain.node("server").server::<u64, u64>("double").unwrap();
    let client = domain.node("client").client::<u64, u64>("double").unwrap();
    until(|| {
        let mut links = server.links();
        links.extend(client.links());
        links.iter().filter(|link| link.open).count() == 2
    });
    let node = domain.node("publisher");
    let publisher = node.publisher_builder::<str>("topic").latched(1);
    let publisher = publisher.declare().unwrap();
    publisher.publish("late").unwrap();
    let subscriber = domain.node("subscriber").subscriber::<str>("topic");
    let subscriber = subscriber.unwrap();
    let call = |number: u64| (number, client.send(&number).unwrap());
    let mut calls: Vec<_> = (0..20).map(call).collect();
    let mut heard = false;

    let epoll = Epoll::new().unwrap();
    epoll.add(&server, SERVER, Interest::READABLE).unwrap();
    epoll.add(&client, CLIENT, Interest::READABLE).unwrap();
    epoll.add(&node, PUBLISHER, Interest::READABLE).unwrap();
    epoll
        .add(&subscriber, SUBSCRIBER, Interest::READABLE)
        .unwrap();
    let mut events = Events::with_capacity(4);
    let deadline = Instant::now() + SOON;
    while !(heard && calls.is_empty()) {
        epoll.wait(&mut events, Some(SOON)).unwrap();
        let left = calls.len();
        assert!(Instant::now() < deadline, "{left} calls, message: {heard}");
        for event in events.iter() {
            match event.token {
                SERVER => {
                    if let Some(request) = server.try_recv().unwrap() {
                        let twice = *request * 2;
                        request.reply(&twice).unwrap();
                    }
                }
                CLIENT => {
                    calls.retain_mut(|(number, call)| {
                        let reply = call.try_wait().unwrap();
                        assert!(reply.as_ref().is_none_or(|reply| **reply == *number * 2));
                        reply.is_none()
                    });
                    if calls.is_empty() {
                        epoll.remove(&client).unwrap();
                    }
                }
                PUBLISHER => node.spin_some().unwrap(),
                _ => {
                    while let Some(sample) = subscriber.try_recv().unwrap() {
                        assert_eq!(&*sample, "late");
                        heard = true;
                    }
                }
            }
        }
    }
}
