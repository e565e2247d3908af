//! A domain with simulated time.

use foxglove::ws_protocol::server::ServerMessage;
use sm2_foxglove::Options;
use sm2_node::clock::{ClockSource, DomainTime};
use sm2_test_support::SOON;
use tungstenite::Message;

use crate::common::{Viewer, World};

fn has_time(viewer: &Viewer) -> bool {
    format!("{:?}", viewer.info.capabilities).contains("Time")
}

/// The next time that the server sends.
fn time(viewer: &mut Viewer) -> u64 {
    viewer.wait(|message| match message {
        ServerMessage::Time(time) => Some(time.timestamp),
        _ => None,
    })
}

#[test]
fn messages_have_the_time_of_the_simulation() {
    let world = World::new();
    let node = world.node("simulator");
    let clock = ClockSource::new(&node).unwrap();
    clock.set(DomainTime(5_000_000_000), 0).unwrap();
    let publisher = node.publisher::<str>("chatter").unwrap();
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    assert!(has_time(&viewer));
    while time(&mut viewer) != 5_000_000_000 {}
    let subscription = viewer.subscribe("chatter");
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    publisher.publish("hi").unwrap();
    assert_eq!(viewer.message(subscription).log_time, 5_000_000_000);
    clock.set(DomainTime(7_000_000_000), 0).unwrap();
    while time(&mut viewer) != 7_000_000_000 {}
    publisher.publish("hi").unwrap();
    assert_eq!(viewer.message(subscription).log_time, 7_000_000_000);
}

#[test]
fn a_clock_that_comes_makes_the_viewer_connect_again() {
    let world = World::new();
    let node = world.node("simulator");
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    assert!(!has_time(&viewer));
    let clock = ClockSource::new(&node).unwrap();
    clock.set(DomainTime(5), 0).unwrap();
    let code = loop {
        if let Message::Close(close) = viewer.frame().unwrap() {
            break u16::from(close.unwrap().code);
        }
    };
    assert_eq!(code, 1012);
    let mut viewer = Viewer::connect(&foxglove.url);
    assert!(has_time(&viewer));
    while time(&mut viewer) != 5 {}
}
