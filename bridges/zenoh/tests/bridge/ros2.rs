//! Topics between a domain and nodes of ROS 2, which `hiroz` provides: it speaks the protocol of rmw_zenoh.

use std::num::NonZeroUsize;
use std::time::Duration;

use crate::common::{ALL, RETRY, SEVEN, World, is_linked, receive, ros, wait_until};
use hiroz::Builder;
use hiroz::MessageTypeInfo;
use hiroz::context::ZContext;
use hiroz::entity::{EndpointKind, entity_get_endpoint};
use hiroz::msg::{ZDeserializer, ZMessage};
use hiroz::qos::{QosDurability, QosHistory, QosProfile};
use hiroz_msgs::sensor_msgs::{Image, PointCloud2};
use hiroz_msgs::std_msgs::String as RosString;
use sm2_node::{Node, Publisher, Subscriber};
use sm2_proto::schema::hash;
use sm2_proto::{Kind, Name, TypeId};
use sm2_test_support::SOON;

/// The type in the domain of a message of ROS 2, and its schema text without the definition.
fn type_of<T: MessageTypeInfo>() -> (TypeId, String) {
    let info = T::type_info();
    let name = info.name.replace("::dds_::", "/").replace("::", "/");
    let data = TypeId {
        name: Name::new(name.trim_end_matches('_')).unwrap(),
        hash: hash::cdr(&info.hash.value),
    };
    (data, format!("cdr:{}\n", info.hash.to_rihs_string()))
}

fn publisher<T: MessageTypeInfo>(node: &Node, topic: &str) -> Publisher<[u8]> {
    let (data, text) = type_of::<T>();
    node.register_schema(data.clone(), &text).unwrap();
    let builder = node.publisher_builder::<[u8]>(topic).type_id(data);
    builder.declare().unwrap()
}

fn subscriber<T: MessageTypeInfo>(node: &Node, topic: &str) -> Subscriber<[u8]> {
    let (data, text) = type_of::<T>();
    node.register_schema(data.clone(), &text).unwrap();
    let builder = node.subscriber_builder::<[u8]>(topic).type_id(data);
    builder.declare().unwrap()
}

/// Messages of the lengths that robots have.
fn messages() -> (RosString, Image, PointCloud2) {
    let bytes: Vec<u8> = (0..1_000_000_u32).map(|it| (it % 251) as u8).collect();
    let text = RosString {
        data: "of the robot".to_owned(),
    };
    let image = Image {
        height: 500,
        width: 2_000,
        encoding: "mono8".to_owned(),
        step: 2_000,
        data: bytes.clone().into(),
        ..Image::default()
    };
    let cloud = PointCloud2 {
        height: 1,
        width: 62_500,
        point_step: 16,
        row_step: 1_000_000,
        data: bytes.into(),
        is_dense: true,
        ..PointCloud2::default()
    };
    (text, image, cloud)
}

/// Sends a message through the bridge in both directions, and compares its bytes.
fn passes<T>(world: &World, ros: &ZContext, topic: &str, message: &T)
where
    T: ZMessage + hiroz::WithTypeInfo,
    for<'a> T::Serdes: ZDeserializer<Input<'a> = &'a [u8]>,
{
    let bytes = message.serialize();
    let node = ros.create_node("robot").build().unwrap();
    let robot = world.node("robot");

    let taken = subscriber::<T>(&robot, &format!("{topic}/in"));
    let talker = node.create_pub::<T>(&format!("/{topic}/in"));
    let talker = talker.build().unwrap();
    // Both are there before the first message: the token of the talker has made a publisher in the domain.
    wait_until(|| taken.links().iter().any(|it| it.open));
    wait_until(|| {
        ros.graph()
            .count(EndpointKind::Subscription, format!("/{topic}/in"))
            == 1
    });
    let mut received = None;
    wait_until(|| {
        talker.publish(message).unwrap();
        let sample = taken.recv_timeout(RETRY).unwrap();
        received = sample.map(|it| it.to_vec());
        received.is_some()
    });
    assert!(received.unwrap() == bytes, "{topic} changes on its way in");

    let listener = node.create_sub::<T>(&format!("/{topic}/out"));
    let listener = listener.build().unwrap();
    let given = publisher::<T>(&robot, &format!("{topic}/out"));
    wait_until(|| is_linked(&given));
    wait_until(|| {
        ros.graph()
            .count(EndpointKind::Publisher, format!("/{topic}/out"))
            == 1
    });
    let mut received = None;
    wait_until(|| {
        given.publish(&bytes).unwrap();
        received = listener.recv_serialized_timeout(RETRY).ok();
        received.is_some()
    });
    assert!(
        *received.unwrap().payload().to_bytes() == *bytes,
        "{topic} changes on its way out"
    );
}

#[test]
fn messages_pass_in_both_directions_without_a_change() {
    let world = World::new();
    let ros = ros(&world);
    let bridge = world.bridge(SEVEN, ALL);
    let (text, image, cloud) = messages();
    passes(&world, &ros, "text", &text);
    passes(&world, &ros, "image", &image);
    passes(&world, &ros, "cloud", &cloud);
    let counts = bridge.end();
    assert!(counts.sent >= 3 && counts.received >= 3, "{counts:?}");
}

/// The nodes that publish a topic in the domain.
fn publishing(node: &Node, topic: &str) -> Vec<String> {
    let domain = node.snapshot().unwrap();
    let interfaces = domain.interfaces().filter(|it| {
        let contract = it.contract;
        contract.kind() == Kind::Publisher && contract.name().as_str() == topic
    });
    let names = interfaces.map(|it| domain.node(it.entity.node).unwrap().name.to_string());
    names.collect()
}

#[test]
fn each_side_sees_the_endpoints_of_the_other_while_they_are_there() {
    let world = World::new();
    let ros = ros(&world);
    let bridge = world.bridge(SEVEN, ALL);
    let robot = world.node("robot");
    let node = ros.create_node("talker").build().unwrap();

    let talker = node.create_pub::<RosString>("/ns/chatter").build().unwrap();
    wait_until(|| publishing(&robot, "ns/chatter") == ["remote/seven"]);
    drop(talker);
    wait_until(|| publishing(&robot, "ns/chatter").is_empty());

    let count = |kind| ros.graph().count(kind, "/state");
    let (given, taken) = (
        publisher::<RosString>(&robot, "state"),
        subscriber::<RosString>(&robot, "state"),
    );
    wait_until(|| count(EndpointKind::Publisher) == 1 && count(EndpointKind::Subscription) == 1);
    let endpoints = (ros.graph()).get_entities_by_topic(EndpointKind::Publisher, "/state");
    let endpoint = entity_get_endpoint(&endpoints[0]).unwrap();
    assert_eq!(endpoint.type_info, Some(RosString::type_info()));
    // hiroz counts endpoints for as long as a program holds them.
    drop((given, taken, endpoints));
    wait_until(|| count(EndpointKind::Publisher) == 0 && count(EndpointKind::Subscription) == 0);
    bridge.end();
}

/// A bridge that starts last knows all that is there. A subscriber of every type gets the messages of one.
#[test]
fn the_last_one_to_come_may_be_the_bridge() {
    let world = World::new();
    let ros = ros(&world);
    let robot = world.node("robot");
    let node = ros.create_node("talker").build().unwrap();
    let talker = node.create_pub::<RosString>("/chatter").build().unwrap();
    let builder = robot.subscriber_builder::<[u8]>("chatter").any_type();
    let recorder = builder.declare().unwrap();
    let bridge = world.bridge(SEVEN, ALL);
    wait_until(|| ros.graph().count(EndpointKind::Subscription, "/chatter") == 1);
    talker.publish(&messages().0).unwrap();
    let sample = recorder.recv_timeout(SOON).unwrap().expect("a message");
    assert_eq!(sample.type_id(), Some(&type_of::<RosString>().0));
    assert_eq!(*sample, *messages().0.serialize());
    bridge.end();
}

/// A denied topic, and one whose type ROS 2 cannot name, are on one side only.
#[test]
fn other_topics_do_not_pass() {
    let rules = "[[rule]]\naction = \"deny\"\nnames = \"secret/**\"\n".to_owned() + ALL;
    let world = World::new();
    let ros = ros(&world);
    let bridge = world.bridge(SEVEN, &rules);
    let robot = world.node("robot");
    let node = ros.create_node("talker").build().unwrap();
    let _talkers = ["/secret/in", "/open/in"].map(|it| node.create_pub::<RosString>(it).build());
    let _given = ["secret/out", "open/out"].map(|it| publisher::<RosString>(&robot, it));
    let _bytes = robot.publisher::<[u8]>("bytes").unwrap();
    wait_until(|| !publishing(&robot, "open/in").is_empty());
    wait_until(|| ros.graph().count(EndpointKind::Publisher, "/open/out") == 1);
    assert!(publishing(&robot, "secret/in").is_empty());
    for topic in ["/secret/out", "/bytes"] {
        assert_eq!(
            ros.graph().count(EndpointKind::Publisher, topic),
            0,
            "{topic}"
        );
    }
    bridge.end();
}

/// Two bridges of one domain and one of another: no message returns to its domain.
#[test]
fn no_message_returns_to_its_domain() {
    let (here, there) = (World::new(), World::new());
    let own = ["one", "two"].map(|it| format!("name = \"{it}\"\nmode = \"ros2\""));
    let own = own.map(|it| here.bridge(&it, ALL));
    let other = there.bridge_to(&here.endpoint, SEVEN, ALL);
    let robot = here.node("robot");
    let given = publisher::<RosString>(&robot, "chatter");
    let echo = subscriber::<RosString>(&robot, "chatter");
    let taken = subscriber::<RosString>(&there.node("station"), "chatter");
    // The subscriber and both bridges, and the subscriptions of all three bridges.
    wait_until(|| given.links().iter().filter(|it| it.open).count() == 3);
    let ros = ros(&here);
    wait_until(|| ros.graph().count(EndpointKind::Subscription, "/chatter") == 3);
    let bytes = messages().0.serialize();
    given.publish(&bytes).unwrap();
    assert_eq!(receive(&taken), bytes);
    assert_eq!(receive(&echo), bytes);
    wait_until(|| taken.try_recv().unwrap().is_some());
    let counts = own.map(|it| it.end());
    assert_eq!(counts.map(|it| (it.sent, it.received)), [(1, 0), (1, 0)]);
    assert_eq!(other.end().sent, 0);
    assert!(echo.try_recv().unwrap().is_none());
}

/// A late joiner on either side gets the last messages, each once.
#[test]
fn late_joiners_get_latched_messages() {
    let world = World::new();
    let ros = ros(&world);
    let bridge = world.bridge(SEVEN, ALL);
    let robot = world.node("robot");
    let node = ros.create_node("node").build().unwrap();
    let qos = QosProfile {
        durability: QosDurability::TransientLocal,
        history: QosHistory::KeepLast(NonZeroUsize::new(2).unwrap()),
        ..QosProfile::default()
    };
    let texts = ["one", "two", "three"].map(|data| RosString { data: data.into() });
    let last = [&texts[1], &texts[2]].map(ZMessage::serialize);

    let (data, text) = type_of::<RosString>();
    robot.register_schema(data.clone(), &text).unwrap();
    let builder = robot.publisher_builder::<[u8]>("map").type_id(data);
    let given = builder.latched(2).declare().unwrap();
    let early = node.create_sub::<RosString>("/map").build().unwrap();
    wait_until(|| is_linked(&given));
    // The bridge may not know the subscription yet.
    wait_until(|| {
        given.publish(&texts[0].serialize()).unwrap();
        early.recv_timeout(Duration::from_millis(200)).is_ok()
    });
    for text in &texts[1..] {
        given.publish(&text.serialize()).unwrap();
    }
    while early.recv_timeout(SOON).unwrap().data != texts[2].data {}
    for _ in 0..2 {
        let listener = node
            .create_sub::<RosString>("/map")
            .with_qos(qos)
            .build()
            .unwrap();
        for bytes in &last {
            let sample = listener.recv_serialized_timeout(SOON).unwrap();
            assert_eq!(*sample.payload().to_bytes(), **bytes);
        }
        assert!(!listener.is_ready());
    }

    let talker = node
        .create_pub::<RosString>("/plan")
        .with_qos(qos)
        .build()
        .unwrap();
    for text in &texts {
        talker.publish(text).unwrap();
    }
    wait_until(|| publishing(&robot, "plan") == ["remote/seven"]);
    for _ in 0..2 {
        let taken = subscriber::<RosString>(&robot, "plan");
        assert_eq!([receive(&taken), receive(&taken)], last);
        assert!(taken.try_recv().unwrap().is_none());
    }
    bridge.end();
}
