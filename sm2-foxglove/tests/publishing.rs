//! Topics that a viewer publishes.

use foxglove::ws_protocol::client::advertise::Channel;
use foxglove::ws_protocol::client::{Advertise, MessageData, Unadvertise};
use foxglove::ws_protocol::schema::Schema;
use sm2_foxglove::Options;
use sm2_node::Node;
use sm2_node::domain::Contract;
use sm2_ros::std_msgs::msg::String as RosString;
use sm2_test_support::{SOON, until};

use crate::common::{Pose, Viewer, World};

fn allowed() -> Options {
    Options {
        allow_publish: true,
        ..Options::default()
    }
}

fn channel(topic: &str, encoding: &str, schema: Schema<'static>) -> Channel<'static> {
    let channel = Channel::builder(1, topic.to_owned(), encoding.to_owned());
    channel.with_schema(schema).build().unwrap().into_owned()
}

fn ros_text() -> Schema<'static> {
    Schema::new("std_msgs/msg/String", "ros2msg", &b"string data\n"[..])
}

fn send(viewer: &mut Viewer, payload: &[u8]) {
    viewer.send(&MessageData::new(1, payload));
}

/// The publishers of a topic, as the domain sees them.
fn publishers(node: &Node, name: &str) -> usize {
    let domain = node.snapshot().unwrap();
    let is_one =
        |it: &Contract| matches!(it, Contract::Publisher { topic, .. } if topic.as_str() == name);
    domain.interfaces().filter(|it| is_one(it.contract)).count()
}

#[test]
fn publishing_needs_the_option() {
    let world = World::new();
    let node = world.node("listener");
    let _subscriber = node.subscriber::<RosString>("chatter").unwrap();
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    let capabilities = format!("{:?}", viewer.info.capabilities);
    assert!(!capabilities.contains("ClientPublish"), "{capabilities}");
    viewer.send(&Advertise::new([channel("/chatter", "cdr", ros_text())]));
    let expected = "cannot publish /chatter: sm2-foxglove runs without --allow-publish";
    assert_eq!(viewer.status(), expected);
    send(&mut viewer, b"\0\x01\0\0\x03\0\0\0hi\0");
    assert!(viewer.status().contains("not advertised"));
    assert_eq!(publishers(&node, "chatter"), 0);
}

#[test]
fn a_viewer_publishes_messages_of_ros_2() {
    let world = World::new();
    let node = world.node("listener");
    let foxglove = world.foxglove(allowed());
    let mut viewer = Viewer::connect(&foxglove.url);
    let capabilities = format!("{:?}", viewer.info.capabilities);
    assert!(capabilities.contains("ClientPublish"), "{capabilities}");
    // No node of the domain knows the topic: the viewer's definition of the type counts.
    viewer.send(&Advertise::new([channel("/chatter", "cdr", ros_text())]));
    let subscriber = node.subscriber::<RosString>("chatter").unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    send(&mut viewer, b"\0\x01\0\0\x03\0\0\0hi\0");
    let sample = subscriber.recv_timeout(SOON).unwrap().unwrap();
    assert_eq!(sample.data, "hi");
    viewer.send(&Unadvertise::new([1]));
    until("no publisher", || publishers(&node, "chatter") == 0);
}

#[test]
fn json_becomes_the_type_of_the_topic() {
    let world = World::new();
    let node = world.node("listener");
    let poses = node.subscriber::<Pose>("goal").unwrap();
    let foxglove = world.foxglove(allowed());
    let mut viewer = Viewer::connect(&foxglove.url);
    let schema = Schema::new("Pose", "jsonschema", &b"{}"[..]);
    viewer.send(&Advertise::new([channel("goal", "json", schema)]));
    poses.wait_for_publishers_timeout(1, SOON).unwrap();
    send(&mut viewer, br#"{"frame":"map","x":1}"#);
    let error = viewer.status();
    assert!(
        error.contains("not published") && error.contains("tags"),
        "{error}"
    );
    send(&mut viewer, br#"{"frame":"map","x":1,"tags":[3]}"#);
    let expected = Pose {
        frame: "map".to_owned(),
        x: 1.0,
        tags: vec![3],
    };
    assert_eq!(*poses.recv_timeout(SOON).unwrap().unwrap(), expected);
}

#[test]
fn topics_that_cannot_be_published_are_reported() {
    let world = World::new();
    let node = world.node("listener");
    let _texts = node.subscriber::<RosString>("chatter").unwrap();
    let foxglove = world.foxglove(allowed());
    let mut viewer = Viewer::connect(&foxglove.url);
    let json = || Schema::new("Pose", "jsonschema", &b"{}"[..]);
    let pose = Schema::new("geometry_msgs/msg/Point", "ros2msg", &b"float64 x\n"[..]);
    for (channel, expected) in [
        (channel("absent", "json", json()), "its type is not known"),
        (channel("a//b", "json", json()), "cannot publish a//b"),
        (
            channel("chatter", "cdr", pose),
            "its type is std_msgs/msg/String, not geometry_msgs/msg/Point",
        ),
        (
            channel(
                "absent",
                "cdr",
                Schema::new("a/msg/B", "ros2msg", &b"nonsense\n"[..]),
            ),
            "cannot publish absent",
        ),
    ] {
        viewer.send(&Advertise::new([channel]));
        let found = viewer.status();
        assert!(found.contains(expected), "{found}");
    }
    assert_eq!(
        publishers(&node, "chatter") + publishers(&node, "absent"),
        0
    );
}
