//! Channels follow the topics of the domain, and have their messages.

use foxglove::ws_protocol::client::{
    Subscribe, SubscribeConnectionGraph, Subscription, Unsubscribe,
};
use foxglove::ws_protocol::server::{ConnectionGraphUpdate, ServerMessage};
use serde_json::json;
use sm2_foxglove::Options;
use sm2_node::clock;
use sm2_proto::gateway::Pattern;
use sm2_ros::std_msgs::msg::String as RosString;
use sm2_test_support::{SOON, until};

use crate::common::{Pose, Report, Viewer, World, subscribers, until_subscribers};

/// The JSON of the next message.
fn json_of(viewer: &mut Viewer, subscription: u32) -> serde_json::Value {
    serde_json::from_slice(&viewer.message(subscription).data).unwrap()
}

#[test]
fn a_text_of_ros_2_arrives_unchanged() {
    let world = World::new();
    let node = world.node("talker");
    let publisher = node.publisher::<RosString>("chatter").unwrap();
    let foxglove = world.foxglove(Options::default());

    let mut viewer = Viewer::connect(&foxglove.url);
    let channel = viewer.channel("chatter");
    assert_eq!(channel.encoding, "cdr");
    assert_eq!(channel.schema_name, "std_msgs/msg/String");
    assert_eq!(channel.schema_encoding.as_deref(), Some("ros2msg"));
    assert_eq!(channel.decode_schema().unwrap(), b"string data\n");

    let subscription = viewer.subscribe("chatter");
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    let before = clock::wall_time().0;
    let text = RosString {
        data: "hi".to_owned(),
    };
    publisher.publish(&text).unwrap();
    let message = viewer.message(subscription);
    assert_eq!(*message.data, *b"\0\x01\0\0\x03\0\0\0hi\0");
    // The wall clock of a test machine may be set, but hardly by an hour.
    assert!(message.log_time.abs_diff(before) < 3_600_000_000_000);
}

#[test]
fn other_types_arrive_as_json() {
    let world = World::new();
    let node = world.node("talker");
    let plain = node.publisher::<str>("plain").unwrap();
    let poses = node.publisher::<Pose>("pose").unwrap();
    let reports = node.publisher::<Report>("report").unwrap();
    let bytes = node.publisher::<[u8]>("bytes").unwrap();
    let foxglove = world.foxglove(Options::default());

    let mut viewer = Viewer::connect(&foxglove.url);
    let mut subscription = |topic, name: &str, properties| {
        let channel = viewer.channel(topic);
        assert_eq!((&*channel.encoding, &*channel.schema_name), ("json", name));
        assert_eq!(channel.schema_encoding.as_deref(), Some("jsonschema"));
        let schema: serde_json::Value = serde_json::from_str(&channel.schema).unwrap();
        assert_eq!(
            schema,
            json!({ "type": "object", "properties": properties })
        );
        viewer.subscribe(topic)
    };
    let text = json!({ "type": "string" });
    let of_plain = subscription("plain", "text", json!({ "value": text }));
    let tags = json!({ "type": "array", "items": { "type": "integer" } });
    let fields = json!({ "frame": text, "x": { "type": "number" }, "tags": tags });
    let of_pose = subscription("pose", "Pose", fields);
    let fields = json!({ "text": text, "level": { "type": "integer" } });
    let of_report = subscription("report", "Report", fields);
    let base64 = json!({ "type": "string", "contentEncoding": "base64" });
    let of_bytes = subscription("bytes", "bytes", json!({ "bytes": base64 }));

    plain.wait_for_subscribers_timeout(1, SOON).unwrap();
    plain.publish("hi").unwrap();
    assert_eq!(json_of(&mut viewer, of_plain), json!({ "value": "hi" }));

    poses.wait_for_subscribers_timeout(1, SOON).unwrap();
    let frame = "map \"1\"".to_owned();
    let pose = Pose {
        frame,
        x: -0.5,
        tags: vec![1, 2],
    };
    poses.publish(&pose).unwrap();
    let expected = json!({ "frame": "map \"1\"", "x": -0.5, "tags": [1, 2] });
    assert_eq!(json_of(&mut viewer, of_pose), expected);

    reports.wait_for_subscribers_timeout(1, SOON).unwrap();
    let text = "fine".to_owned();
    reports.publish(&Report { text, level: 3 }).unwrap();
    let message = viewer.message(of_report);
    assert_eq!(*message.data, *br#"{"text":"fine","level":3}"#, "unchanged");

    bytes.wait_for_subscribers_timeout(1, SOON).unwrap();
    bytes.publish(&[0, 255, 16]).unwrap();
    assert_eq!(json_of(&mut viewer, of_bytes), json!({ "bytes": "AP8Q" }));
}

#[test]
fn channels_follow_joins_and_leaves() {
    let world = World::new();
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    let node = world.node("talker");
    for _ in 0..3 {
        let publisher = node.publisher::<RosString>("chatter").unwrap();
        let subscription = viewer.subscribe("chatter");
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        let text = RosString {
            data: "hi".to_owned(),
        };
        publisher.publish(&text).unwrap();
        viewer.message(subscription);
        drop(publisher);
        viewer.no_channel("chatter");
        until_subscribers(&node, "chatter", 0);
    }
}

#[test]
fn a_topic_has_a_subscriber_only_while_a_viewer_looks() {
    let world = World::new();
    let node = world.node("talker");
    let _publisher = node.publisher::<RosString>("chatter").unwrap();
    let foxglove = world.foxglove(Options::default());
    let mut one = Viewer::connect(&foxglove.url);
    let mut other = Viewer::connect(&foxglove.url);
    one.channel("chatter");
    other.channel("chatter");
    assert_eq!(
        subscribers(&node, "chatter"),
        0,
        "both viewers know the channel"
    );

    let subscription = one.subscribe("chatter");
    until_subscribers(&node, "chatter", 1);
    other.subscribe("chatter");
    until_subscribers(&node, "chatter", 2);
    one.send(&Unsubscribe::new([subscription]));
    until_subscribers(&node, "chatter", 1);
    drop(other);
    until_subscribers(&node, "chatter", 0);
}

#[test]
fn every_viewer_gets_the_latched_messages() {
    let world = World::new();
    let node = world.node("map_server");
    let publisher = node.publisher_builder::<str>("map").latched(20);
    let publisher = publisher.declare().unwrap();
    for at in 0..20 {
        publisher.publish(&at.to_string()).unwrap();
    }
    let foxglove = world.foxglove(Options::default());
    let mut viewers = [(); 2].map(|()| Viewer::connect(&foxglove.url));
    for viewer in &mut viewers {
        let subscription = viewer.subscribe("map");
        for at in 0..20 {
            assert_eq!(
                json_of(viewer, subscription),
                json!({ "value": at.to_string() })
            );
        }
    }
}

#[test]
fn only_the_chosen_topics_are_shown() {
    let world = World::new();
    let node = world.node("talker");
    let topics = ["camera/left", "camera/right/info", "scan", "tf"];
    let _publishers = topics.map(|it| node.publisher::<str>(it).unwrap());
    let patterns = ["camera/**", "scan", "absent"].map(|it| Pattern::new(it).unwrap());
    let foxglove = world.foxglove(Options {
        topics: patterns.to_vec(),
        ..Options::default()
    });
    let mut viewer = Viewer::connect(&foxglove.url);
    for topic in &topics[..3] {
        viewer.channel(topic);
    }
    assert_eq!(
        viewer.topics(),
        topics[..3],
        "all channels come in one message"
    );
}

#[test]
fn two_types_of_one_topic_do_not_mix() {
    let world = World::new();
    let node = world.node("talker");
    let publisher = node.publisher::<str>("chatter").unwrap();
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    let subscription = viewer.subscribe("chatter");
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    drop(publisher);
    // The viewer's subscription does not keep the next publisher from having another type.
    let publisher = node.publisher::<Pose>("chatter").unwrap();
    viewer.wait(|message| match message {
        ServerMessage::Advertise(it) => it
            .channels
            .iter()
            .any(|it| it.schema_name == "Pose")
            .then_some(()),
        _ => None,
    });
    let other = viewer.subscribe("chatter");
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    let (frame, tags) = ("map".to_owned(), Vec::new());
    publisher
        .publish(&Pose {
            frame,
            x: 1.0,
            tags,
        })
        .unwrap();
    assert_ne!(subscription, other);
    assert_eq!(json_of(&mut viewer, other)["frame"], "map");
}

#[test]
fn a_viewer_survives_the_end_of_the_manager() {
    let mut world = World::new();
    let node = world.node("talker");
    let publisher = node.publisher::<str>("chatter").unwrap();
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    let subscription = viewer.subscribe("chatter");
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    world.end_manager();
    until("the Manager is gone", || !node.is_connected());
    publisher.publish("without a Manager").unwrap();
    let expected = json!({ "value": "without a Manager" });
    assert_eq!(json_of(&mut viewer, subscription), expected);

    world.start_manager();
    let other = node.publisher::<str>("other").unwrap();
    let subscription = viewer.subscribe("other");
    other.wait_for_subscribers_timeout(1, SOON).unwrap();
    other.publish("hi").unwrap();
    assert_eq!(json_of(&mut viewer, subscription), json!({ "value": "hi" }));
    viewer.channel("chatter");
}

#[test]
fn wrong_subscriptions_are_reported() {
    let world = World::new();
    let node = world.node("talker");
    let _publisher = node.publisher::<str>("chatter").unwrap();
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    viewer.send(&Subscribe::new([Subscription::new(1, 12_345)]));
    assert_eq!(viewer.status(), "there is no channel 12345");
    let subscription = viewer.subscribe("chatter");
    let channel = viewer.channel("chatter");
    viewer.send(&Subscribe::new([Subscription::new(
        subscription,
        channel.id,
    )]));
    assert_eq!(viewer.status(), "the subscription 1 exists already");
    viewer.send(tungstenite::Message::text("{"));
    assert!(viewer.status().starts_with("no message: EOF"));
    viewer.send(tungstenite::Message::text(
        r#"{"op":"fetchAsset","uri":"x","requestId":1}"#,
    ));
    assert_eq!(viewer.status(), "this server does not offer the operation");
    viewer.send(tungstenite::Message::binary(vec![9, 9]));
    assert_eq!(viewer.status(), "a binary message of no known kind");
}

#[test]
fn a_message_that_is_too_long_to_convert_is_reported_once() {
    let world = World::new();
    let node = world.node("talker");
    let publisher = node.publisher::<[u8]>("bytes").unwrap();
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    let subscription = viewer.subscribe("bytes");
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    let long = vec![0; 1024 * 1024 + 1];
    publisher.publish(&long).unwrap();
    publisher.publish(&long).unwrap();
    publisher.publish(b"hi").unwrap();
    assert_eq!(
        json_of(&mut viewer, subscription),
        json!({ "bytes": "aGk=" })
    );
    let expected = "a message of bytes is not shown: 1048577 bytes long, and at most 1048576 are converted to JSON";
    assert_eq!(viewer.status(), expected);
    publisher.publish(&long).unwrap();
    publisher.publish(b"hi").unwrap();
    viewer.message(subscription);
    // A later answer: no second report came before it.
    viewer.send(tungstenite::Message::binary(vec![9, 9]));
    assert_eq!(viewer.status(), "a binary message of no known kind");
}

/// The next update of the connection graph.
fn graph(viewer: &mut Viewer) -> ConnectionGraphUpdate {
    viewer.wait(|message| match message {
        ServerMessage::ConnectionGraphUpdate(update) => Some(update.clone()),
        _ => None,
    })
}

#[test]
fn the_connection_graph_follows_the_domain() {
    let world = World::new();
    let node = world.node("talker");
    let publisher = node.publisher::<str>("chatter").unwrap();
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    assert!(
        viewer
            .info
            .capabilities
            .iter()
            .any(|it| format!("{it:?}") == "ConnectionGraph")
    );
    viewer.channel("chatter");
    viewer.send(&SubscribeConnectionGraph {});
    let update = graph(&mut viewer);
    assert_eq!(update.published_topics.len(), 1);
    assert_eq!(update.published_topics[0].name, "chatter");
    assert_eq!(update.published_topics[0].publisher_ids, ["talker"]);
    assert!(update.subscribed_topics.is_empty() && update.removed_topics.is_empty());

    // The subscriptions of viewers are not shown.
    viewer.subscribe("chatter");
    until_subscribers(&node, "chatter", 1);
    let listener = world.node("listener");
    let subscriber = listener.subscriber::<str>("chatter").unwrap();
    let update = graph(&mut viewer);
    assert_eq!(update.subscribed_topics[0].name, "chatter");
    assert_eq!(update.subscribed_topics[0].subscriber_ids, ["listener"]);
    let server = listener.server::<str, str>("echo").unwrap();
    let update = graph(&mut viewer);
    assert_eq!(update.advertised_services[0].name, "echo");
    assert_eq!(update.advertised_services[0].provider_ids, ["listener"]);

    drop(publisher);
    let update = graph(&mut viewer);
    assert_eq!(update.published_topics[0].publisher_ids, [""; 0]);
    assert!(update.removed_topics.is_empty(), "it has a subscriber");
    drop(subscriber);
    assert_eq!(graph(&mut viewer).removed_topics, ["chatter"]);
    drop(server);
    assert_eq!(graph(&mut viewer).removed_services, ["echo"]);
}
