//! Messages of ROS 2 are printed and published by the definitions that a node has registered.

use std::{fs, path::Path, time::Duration};

use serde_json::json;
use sm2_node::{Name, Node, Publisher, TypeId};
use sm2_proto::schema::Schema;
use sm2_ros_idl::{Set, TypeName};

use crate::common::{Domain, Running, until};

const STRING: &str = "std_msgs/msg/String";
const POSE: &str = "geometry_msgs/msg/PoseStamped";
const HELLO: &[u8] = b"\0\x01\0\0\x06\0\0\0hello\0";

fn definitions() -> Set {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sm2-ros/definitions");
    let mut set = Set::default();
    set.add_folder(&folder).unwrap();
    set
}

fn schema_text(name: &str) -> String {
    let name: TypeName = name.parse().unwrap();
    definitions().schema_text(&name).unwrap()
}

/// Registers a schema text, and returns the type with this name.
fn register(node: &Node, name: &str, text: &str) -> TypeId {
    let data = TypeId {
        name: Name::new(name).unwrap(),
        hash: Schema::parse(text).unwrap().hash(),
    };
    node.register_schema(data.clone(), text).unwrap();
    data
}

/// A publisher with one message for each subscriber.
fn publisher(node: &Node, topic: &str, data: TypeId, message: &[u8]) -> Publisher<[u8]> {
    let builder = node.publisher_builder::<[u8]>(topic).latched(1);
    let publisher = builder.type_id(data).declare().unwrap();
    publisher.publish(message).unwrap();
    publisher
}

/// Runs `sm2 topic echo --count 1` while the node works.
fn echo(domain: &Domain, node: &Node, topic: &str, options: &[&str]) -> Running {
    let echo = ["topic", "echo", topic, "--count", "1"];
    let echo = domain.start(&[&echo, options].concat());
    until("the message is there", || {
        let timeout = Duration::from_millis(5);
        node.spin_once_timeout(timeout).unwrap();
        !echo.stdout().is_empty()
    });
    echo
}

fn echoed(domain: &Domain, node: &Node, topic: &str) -> serde_json::Value {
    let line = echo(domain, node, topic, &["--json"]).finish().stdout();
    serde_json::from_str(&line).unwrap()
}

//= SM2-TYP-002 test
#[test]
fn messages_of_ros_2_are_printed_and_published_by_their_definitions() {
    let domain = Domain::new();
    let node = domain.node("node");
    let data = register(&node, STRING, &schema_text(STRING));
    let _string = publisher(&node, "text", data, HELLO);
    assert_eq!(
        echo(&domain, &node, "text", &[]).finish().stdout(),
        "{data: \"hello\"}\n"
    );
    let line = echoed(&domain, &node, "text");
    assert_eq!(line["value"], json!({ "data": "hello" }));

    let value = json!({
        "header": { "stamp": { "sec": 7, "nanosec": 8 }, "frame_id": "map" },
        "pose": {
            "position": { "x": 1.5, "y": -2.0, "z": 0.0 },
            "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
        },
    });
    let name: TypeName = POSE.parse().unwrap();
    let bytes = sm2_ros::encode(&definitions(), &name, &value).unwrap();
    let data = register(&node, POSE, &schema_text(POSE));
    let _pose = publisher(&node, "pose", data, &bytes);
    assert_eq!(echoed(&domain, &node, "pose")["value"], value);

    // The command line publishes a type whose text is in the domain.
    let subscriber = node.subscriber_builder::<[u8]>("text").any_type();
    let subscriber = subscriber.declare().unwrap();
    let publish = ["topic", "pub", "text", "--type", STRING, "--value"];
    let hello = [
        &publish[..],
        &["{\"data\": \"hello\"}", "--rate", "200", "--loop"],
    ]
    .concat();
    let _publish = domain.start(&hello);
    let sample = subscriber.recv_timeout(Duration::from_secs(60)).unwrap();
    assert_eq!(&*sample.unwrap(), HELLO);
    let wrong = [&publish[..], &["{\"date\": \"hello\"}"]].concat();
    let expected = ["not a message of type std_msgs/msg/String", "no field date"];
    domain.run(&wrong).failed(1, &expected);
}

/// Receives the message that the command publishes, and its type.
fn published(domain: &Domain, node: &Node, topic: &str, options: &[&str]) -> (TypeId, Vec<u8>) {
    let subscriber = node.subscriber_builder::<[u8]>(topic).any_type();
    let subscriber = subscriber.declare().unwrap();
    let publish = ["topic", "pub", topic, "--rate", "200", "--loop"];
    let publish = domain.start(&[&publish, options].concat());
    let sample = subscriber.recv_timeout(Duration::from_secs(60)).unwrap();
    let sample = sample.unwrap_or_else(|| panic!("no message: {}", publish.stderr()));
    (sample.type_id().unwrap().clone(), sample.to_vec())
}

#[test]
fn types_of_the_common_interfaces_need_no_node_that_knows_them() {
    let domain = Domain::new();
    let node = domain.node("node");
    let value = ["--type", STRING, "--value", "{\"data\": \"hello\"}"];
    let (data, message) = published(&domain, &node, "text", &value);
    let schema = Schema::parse(&schema_text(STRING)).unwrap();
    assert_eq!((data.hash, &*message), (schema.hash(), HELLO));

    // The publisher states a type whose text is not in the domain.
    let other = Domain::new();
    let node = other.node("node");
    let _string = publisher(&node, "text", data, HELLO);
    let line = echoed(&other, &node, "text");
    assert_eq!(line["value"], json!({ "data": "hello" }));
    let typed = echo(&other, &node, "text", &["--type", STRING]);
    assert_eq!(typed.finish().stdout(), "{data: \"hello\"}\n");
    let wrong = ["topic", "echo", "text", "--type", POSE, "--count", "1"];
    other.run(&wrong).failed(1, &[POSE, STRING]);
    let wrong = ["topic", "echo", "text", "--type", "my_msgs/msg/Wheel"];
    let expected = ["no definition of my_msgs/msg/Wheel", "--definitions"];
    other.run(&wrong).failed(1, &expected);
}

#[test]
fn types_of_the_user_are_read_from_a_folder() {
    let domain = Domain::new();
    let node = domain.node("node");
    let package = domain.path("msgs/my_msgs");
    fs::create_dir_all(package.join("msg")).unwrap();
    let wheel = "std_msgs/Header header\nfloat64 speed 2.5\n";
    fs::write(package.join("msg/Wheel.msg"), wheel).unwrap();
    let folder = domain.path("msgs");
    for folder in [&folder, &package] {
        let options = [
            "--definitions",
            folder.to_str().unwrap(),
            "--type",
            "my_msgs/msg/Wheel",
        ];
        let value = ["--value", "{\"header\": {\"frame_id\": \"left\"}}"];
        let (data, message) = published(&domain, &node, "wheel", &[&options[..], &value].concat());
        let other = Domain::new();
        let node = other.node("node");
        let _wheel = publisher(&node, "wheel", data, &message);
        let json = [&options[..], &["--json"]].concat();
        let line = echo(&other, &node, "wheel", &json).finish().stdout();
        let line: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!(line["value"]["speed"], 2.5, "{line}");
        assert_eq!(line["value"]["header"]["frame_id"], "left");
    }
    fs::write(package.join("msg/Wheel.msg"), "float64\n").unwrap();
    let folder = folder.to_str().unwrap();
    let wrong = ["topic", "echo", "wheel", "--type", STRING, "--definitions"];
    let expected = ["--definitions", "Wheel.msg: line 1"];
    domain
        .run(&[&wrong[..], &[folder]].concat())
        .failed(1, &expected);
}

#[test]
fn a_definition_of_another_hash_is_reported_once() {
    let domain = Domain::new();
    let node = domain.node("node");
    let text = schema_text(STRING).replace("data", "date");
    let data = register(&node, STRING, &text);
    let _string = publisher(&node, "text", data, HELLO);
    let reason = "type std_msgs/msg/String ";
    let echo = echo(&domain, &node, "text", &["--json"]).finish();
    let line: serde_json::Value = serde_json::from_str(&echo.stdout()).unwrap();
    assert!(line["value"].is_null(), "{line}");
    let stderr = echo.stderr();
    let lines = stderr
        .lines()
        .filter(|line| line.contains("by their definition"));
    let lines: Vec<_> = lines.collect();
    assert_eq!(lines.len(), 1, "{stderr}");
    assert!(
        lines[0].contains(reason) && lines[0].contains("RIHS01_df668c"),
        "{stderr}"
    );
    let value = ["topic", "pub", "text", "--value", "{\"data\": \"hello\"}"];
    domain.run(&value).failed(1, &[reason, "RIHS01_df668c"]);
}

/// Requests and replies are encoded and decoded, too.
#[test]
fn a_call_takes_and_prints_messages_of_ros_2() {
    let domain = Domain::new();
    let node = domain.node("node");
    let types = [
        "std_srvs/srv/SetBool_Request",
        "std_srvs/srv/SetBool_Response",
    ];
    let [request, reply] = types.map(|name| register(&node, name, &schema_text(name)));
    let server = node
        .server_builder::<[u8], [u8]>("power")
        .type_ids(request, reply);
    let server = server.declare().unwrap();
    let call = ["service", "call", "power", "{\"data\": true}", "--json"];
    let call = domain.start(&call);
    let asked = server.recv_timeout(Duration::from_secs(60)).unwrap();
    let asked = asked.unwrap_or_else(|| panic!("no request: {}", call.stderr()));
    assert_eq!(&*asked, b"\0\x01\0\0\x01");
    let name: TypeName = types[1].parse().unwrap();
    let answer = json!({ "success": true, "message": "on" });
    let bytes = sm2_ros::encode(&definitions(), &name, &answer).unwrap();
    asked.reply(&bytes).unwrap();
    until("the reply is printed", || {
        let timeout = Duration::from_millis(5);
        node.spin_once_timeout(timeout).unwrap();
        !call.stdout().is_empty()
    });
    let line: serde_json::Value = serde_json::from_str(&call.finish().stdout()).unwrap();
    assert_eq!(line["value"], answer);
}
