//! Topics between a domain and a network of Zenoh.

use std::path::Path;
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use crate::common::{ALL, RETRY, World, is_linked, receive, wait_until};
use sm2_bridge_zenoh::Config;
use sm2_test_support::{SOON, until};
use zenoh::Wait;

const RULES: &str = r#"
[[rule]]
action = "deny"
names = "secret/**"

[[rule]]
action = "allow"
kind = "topic"
names = "camera/*"
direction = "out"

[[rule]]
action = "allow"
names = "command/**"
direction = "in"
"#;

/// The start of the configuration of a bridge.
fn head(name: &str) -> String {
    format!("name = \"{name}\"\nprefix = \"robot/7\"")
}

/// The keys, the encodings and the bytes of the messages below `key` in the network.
fn listen(world: &World, key: &str) -> Receiver<(String, String, Vec<u8>)> {
    let (sender, messages) = channel();
    let subscriber = world
        .network
        .declare_subscriber(key)
        .callback(move |sample| {
            let (key, encoding) = (sample.key_expr().to_string(), sample.encoding().to_string());
            let _ = sender.send((key, encoding, sample.payload().to_bytes().into_owned()));
        });
    subscriber.background().wait().unwrap();
    messages
}

#[test]
fn topics_pass_in_both_directions_and_denied_ones_do_not() {
    let world = World::new();
    let messages = listen(&world, "robot/7/**");
    let robot = world.node("robot");
    let image = robot.publisher::<[u8]>("camera/image").unwrap();
    let secret = robot.publisher::<[u8]>("secret/key").unwrap();
    let speed = robot.subscriber::<[u8]>("command/speed").unwrap();
    let stolen = robot.subscriber::<[u8]>("camera/image").unwrap();
    let bridge = world.bridge(&head("seven"), RULES);

    // A long one, which goes to Zenoh from its slot, and a short one.
    wait_until(|| image.links().iter().filter(|it| it.open).count() == 2);
    for len in [3_000_000, 5] {
        let payload: Vec<u8> = (0..len).map(|it| (it % 251) as u8).collect();
        let mut message = None;
        wait_until(|| {
            image.publish(&payload).unwrap();
            secret.publish(&payload).unwrap();
            assert_eq!(receive(&stolen), payload);
            message = messages.recv_timeout(RETRY).ok();
            message.is_some()
        });
        let (key, encoding, bytes) = message.unwrap();
        assert_eq!(key, "robot/7/camera/image");
        assert!(encoding.starts_with("zenoh/bytes;sm2:"), "{encoding}");
        assert!(bytes == payload, "{len}");
    }
    assert!(!is_linked(&secret));

    world
        .network
        .put("robot/7/camera/image", "forged")
        .wait()
        .unwrap();
    world
        .network
        .put("robot/7/command/speed", "0.5")
        .wait()
        .unwrap();
    assert_eq!(receive(&speed), b"0.5");
    assert!(stolen.try_recv().unwrap().is_none());

    let counts = bridge.end();
    assert!(counts.sent >= 2, "{counts:?}");
    assert_eq!((counts.received, counts.denied), (1, 1), "{counts:?}");
}

#[test]
fn the_bridge_subscribes_only_while_the_network_does() {
    let world = World::new();
    let image = world
        .node("robot")
        .publisher::<[u8]>("camera/image")
        .unwrap();
    let bridge = world.bridge(&head("seven"), RULES);
    let subscriber = world
        .network
        .declare_subscriber("robot/7/camera/*")
        .wait()
        .unwrap();
    wait_until(|| is_linked(&image));
    subscriber.undeclare().wait().unwrap();
    wait_until(|| !is_linked(&image));
    bridge.end();
}

#[test]
fn a_topic_keeps_the_budget_of_its_rule() {
    let slow =
        "[[rule]]\naction = \"allow\"\nnames = \"map\"\nbytes_per_s = 1\nmax_age_ms = 100000000\n";
    let world = World::new();
    let messages = listen(&world, "robot/7/**");
    let bridge = world.bridge(&head("seven"), &format!("{slow}{ALL}"));
    let robot = world.node("robot");
    let [map, pose] = ["map", "pose"].map(|it| robot.publisher::<[u8]>(it).unwrap());
    for publisher in [&map, &pose] {
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    }
    let next = || messages.recv_timeout(SOON).unwrap().0;
    // After this message, the budget is spent for more than a day.
    map.publish(&[0; 100_000]).unwrap();
    assert_eq!(next(), "robot/7/map");
    for _ in 0..3 {
        map.publish(&[1]).unwrap();
        pose.publish(&[1]).unwrap();
        assert_eq!(next(), "robot/7/pose");
    }
    until("the bridge has all", || {
        let links = map.links();
        let counters = links.iter().filter(|it| it.open).map(|it| it.counters);
        counters.into_iter().all(|it| it.delivered == it.offered)
    });
    let counts = bridge.end();
    assert_eq!((counts.sent, counts.withdrawn), (4, 3), "{counts}");
}

#[test]
fn two_bridges_of_a_domain_carry_nothing_twice() {
    let rules = "[[rule]]\naction = \"allow\"\nnames = \"**\"\n";
    let world = World::new();
    let messages = listen(&world, "robot/7/topic");
    let robot = world.node("robot");
    let publisher = robot.publisher::<[u8]>("topic").unwrap();
    let subscriber = robot.subscriber::<[u8]>("topic").unwrap();
    let bridges = ["one", "two"].map(|it| world.bridge(&head(it), rules));
    wait_until(|| publisher.links().iter().filter(|it| it.open).count() == 3);
    publisher.publish(b"once").unwrap();
    // Each bridge puts it into the network, and neither brings it back.
    let expected = [&messages, &messages].map(|it| it.recv_timeout(SOON).unwrap().2);
    assert_eq!(expected, [b"once", b"once"]);
    let counts = bridges.map(|it| {
        thread::sleep(Duration::from_millis(300));
        it.end()
    });
    assert_eq!(counts.map(|it| it.received), [0, 0]);
    assert_eq!(counts.map(|it| it.returned), [1, 1]);
    assert_eq!(receive(&subscriber), b"once");
    assert!(subscriber.try_recv().unwrap().is_none());
}

#[test]
fn wrong_configurations_are_refused_with_the_line() {
    let refused = |text: &str| {
        let error = Config::parse(Path::new("bridge.toml"), text).unwrap_err();
        error.to_string()
    };
    let head = "name = \"a\"\n[zenoh]\n";
    for (text, expected) in [
        (
            "name = \"a b\"\n[zenoh]\n".to_owned(),
            "bridge.toml:1: a name holds only",
        ),
        (
            format!("{head}hosts = []\n"),
            "bridge.toml:3: unknown field `hosts`",
        ),
        (
            format!("{head}[[rule]]\naction = \"allow\"\nnames = \"a//b\"\n"),
            "bridge.toml:5: segment 2",
        ),
        (
            format!("{head}[[rule]]\naction = \"allow\"\nnames = \"a\"\npriority = 8\n"),
            "bridge.toml:6: a priority is 0 to 7",
        ),
        (
            format!("{head}[[rule]]\naction = \"allow\"\nnames = \"a\"\nbytes_per_s = 0\n"),
            "bridge.toml:6: invalid value",
        ),
        (
            format!("prefix = \"a/*\"\n{head}"),
            "bridge.toml:1: the prefix is not a name",
        ),
        (
            format!("ros_domain_id = 1\n{head}"),
            "bridge.toml:1: `ros_domain_id` has no effect in mode `plain`",
        ),
        (
            format!("mode = \"ros2\"\nprefix = \"a\"\n{head}"),
            "bridge.toml:2: `prefix` has no effect in mode `ros2`",
        ),
        (
            format!("mode = \"ros2\"\nros_domain_id = 233\n{head}"),
            "bridge.toml:2: `ros_domain_id` is at most 232",
        ),
        (
            "mode = \"ros2\"\nname = \"robot/7\"\n[zenoh]\n".to_owned(),
            "bridge.toml:2: in mode `ros2` the name begins with a letter",
        ),
        (
            format!("{head}connect = [\"nowhere\"]\n"),
            "bridge.toml:2: Zenoh refuses `connect/endpoints`",
        ),
    ] {
        let error = refused(&text);
        assert!(error.starts_with(expected), "{error}");
    }
}
