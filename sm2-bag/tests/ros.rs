//! Bags with types of ROS 2.

use std::collections::BTreeSet;
use std::fs;
use std::os::fd::AsFd;
use std::path::Path;
use std::slice;
use std::thread;

use sm2_bag::{
    Bag, Compression, Filter, Options, PlayError, PlayOptions, Player, Report, check, copy, recover,
};
use sm2_node::diagnostics::LinkStatus;
use sm2_node::{Message, Name, Node, Publisher, Shutdown, TypeId};

use crate::common::{Domain, SOON, named, record};

const STRING: &str = "std_msgs/msg/String";
const STRING_SCHEMA: &str =
    "cdr:RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18\nstring data\n";
const HELLO: &[u8] = b"\0\x01\0\0\x06\0\0\0hello\0";

/// The type `std_msgs/msg/String` of ROS 2.
fn string_type() -> TypeId {
    let schema = sm2_proto::schema::Schema::parse(STRING_SCHEMA).unwrap();
    TypeId {
        name: Name::new(STRING).unwrap(),
        hash: schema.hash(),
    }
}

fn string_publisher(node: &Node, topic: &str) -> Publisher<[u8]> {
    node.register_schema(string_type(), STRING_SCHEMA).unwrap();
    let builder = node.publisher_builder::<[u8]>(topic);
    builder.type_id(string_type()).declare().unwrap()
}

/// Records one message of each publisher.
fn record_each(domain: &Domain, name: &str, publishers: &[(&Publisher<[u8]>, &[u8])]) -> Report {
    let topics: Vec<_> = publishers.iter().map(|it| it.0.topic().as_str()).collect();
    // The first chunk ends with the recording, however long a busy machine takes.
    let options = Options {
        sync_interval: SOON,
        ..Options::new(named(&topics))
    };
    // The links of an earlier recorder may still be there.
    let recorder = domain.node(name);
    let is_ours = |it: &LinkStatus| it.open && it.peer.name == *recorder.name();
    record(&recorder, domain.create(name), options, |record_until| {
        record_until(&mut |_| {
            let mut all = publishers.iter();
            all.all(|(publisher, _)| publisher.links().iter().any(is_ours))
        });
        for (publisher, message) in publishers {
            publisher.publish(message).unwrap();
        }
        // The messages are taken, and wait for the end of the chunk.
        let all: usize = publishers.iter().map(|it| it.1.len()).sum();
        record_until(&mut |it| it.progress().bytes + it.progress().waiting_bytes == all as u64);
    })
}

/// The profile in the header of a bag, behind the magic bytes, the opcode and the length of the record.
fn profile(path: &Path) -> String {
    let bytes = fs::read(path).unwrap();
    let (_, rest) = bytes.split_at(8 + 1 + 8);
    let (len, rest) = rest.split_at(4);
    let len = u32::from_le_bytes(len.try_into().unwrap());
    String::from_utf8(rest[..len as usize].to_vec()).unwrap()
}

#[test]
fn a_bag_whose_types_are_all_of_ros_2_has_its_profile() {
    let domain = Domain::new();
    let node = domain.node("talker");
    let text = string_publisher(&node, "text");
    let more = string_publisher(&node, "more");
    let count = node.publisher_builder::<[u8]>("count");
    let count = count.type_id(<u8 as Message>::type_id()).declare().unwrap();

    record_each(&domain, "ros", &[(&text, HELLO), (&more, HELLO)]);
    let report = record_each(&domain, "both", &[(&text, HELLO), (&count, b"1")]);
    record_each(&domain, "none", &[]);
    let path = |name: &str| domain.path(name);
    for (name, expected) in [("ros", "ros2"), ("both", "sm2"), ("none", "sm2")] {
        assert_eq!(profile(&path(name)), expected, "{name}");
        assert_eq!(check(&path(name)).unwrap().damages, [], "{name}");
        let recovered = path(&format!("{name}.recovered"));
        recover(&path(name), &recovered).unwrap();
        assert_eq!(profile(&recovered), expected, "{name}");
    }
    let bag = Bag::open(&path("both")).unwrap();
    assert_eq!(bag.report(), report);
    for (topic, expected) in [("text", "ros2"), ("count", "sm2")] {
        let filter = Filter {
            topics: BTreeSet::from([topic.to_owned()]),
            ..Filter::default()
        };
        copy(
            slice::from_ref(&bag),
            &path(topic),
            &filter,
            Compression::None,
        )
        .unwrap();
        assert_eq!(profile(&path(topic)), expected, "{topic}");
    }
}

const POSE: &str = "geometry_msgs/msg/PoseStamped";
/// As rosbag2 writes it: with comments, and without `msg` in the names.
const POSE_DEFINITION: &str = "# A pose.

std_msgs/Header header
Pose pose

================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Pose
Point position
Quaternion orientation
================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

/// Writes a bag as rosbag2 does, with five messages of a topic.
fn write_foreign(path: &Path, (name, encoding, definition): (&str, &str, &str), rihs01: &str) {
    let options = mcap::WriteOptions::new()
        .profile("ros2")
        .library("libmcap 1.1.0");
    let mut writer = options.create(fs::File::create(path).unwrap()).unwrap();
    let schema = writer.add_schema(name, encoding, definition.as_bytes());
    let qos = "- history: keep_last\n  depth: 10\n  reliability: reliable\n  durability: transient_local\n";
    let metadata = [("offered_qos_profiles", qos), ("topic_type_hash", rihs01)];
    let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned()));
    let channel = writer.add_channel(schema.unwrap(), "/text", "cdr", &metadata.into());
    let channel_id = channel.unwrap();
    for sequence in 0..5 {
        let time = 1_000 + u64::from(sequence);
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, HELLO).unwrap();
    }
    writer.finish().unwrap();
}

fn player<'a>(
    domain: &Domain,
    bag: &'a Bag,
    shutdown: &'a Shutdown,
) -> Result<Player<'a>, PlayError> {
    let options = PlayOptions {
        rate: 0.0,
        filter: Filter {
            topics: BTreeSet::from(["text".to_owned()]),
            ..Filter::default()
        },
        ..PlayOptions::default()
    };
    let connect = |name: &str| Node::builder(name).socket(domain.path("sock")).connect();
    Player::new(slice::from_ref(bag), options, connect, shutdown.as_fd())
}

#[test]
fn a_bag_of_another_program_is_shown_and_played() {
    let domain = Domain::new();
    let path = domain.path("rosbag2.mcap");
    let rihs01 = STRING_SCHEMA[4..].split_once('\n').unwrap().0;
    let definition = "# A text.\nstring data  # any\n";
    write_foreign(&path, (STRING, "ros2msg", definition), rihs01);
    let bag = Bag::open(&path).unwrap();
    let report = bag.report();
    let topic = &report.topics[0];
    assert!(report.complete);
    assert_eq!((&*topic.name, &*topic.r#type.name), ("/text", STRING));
    // The index has no lengths.
    assert_eq!((topic.messages, topic.bytes), (5, None));

    let listener = domain.node("listener");
    let texts = listener.subscriber_builder::<[u8]>("text").depth(16);
    let texts = texts.type_id(string_type()).reliable(true);
    let texts = texts.declare().unwrap();
    let shutdown = Shutdown::new().unwrap();
    let mut player = player(&domain, &bag, &shutdown).unwrap();
    let receive = thread::spawn(move || {
        for _ in 0..5 {
            let sample = texts.recv_timeout(SOON).unwrap().unwrap();
            assert_eq!(sample.publisher().as_str(), "play/bag");
            assert_eq!(&*sample, HELLO);
        }
    });
    let played = player.play().unwrap();
    assert_eq!((played.complete, played.topics[0].messages), (true, 5));
    receive.join().unwrap();
    let text = listener.describe(&string_type()).unwrap();
    assert_eq!(text.as_deref(), Some(STRING_SCHEMA));
    // The player is latched, because the recorded publisher was.
    let late = listener.subscriber_builder::<[u8]>("text").depth(16);
    let late = late.type_id(string_type()).declare().unwrap();
    assert_eq!(&*late.recv_timeout(SOON).unwrap().unwrap(), HELLO);
}

#[test]
fn the_hash_of_a_foreign_type_is_that_of_its_definition() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pose.mcap");
    write_foreign(&path, (POSE, "ros2msg", POSE_DEFINITION), "");
    let bag = Bag::open(&path).unwrap();
    let (_, source) = bag.sources().next().unwrap();
    let source = source.unwrap();
    let name = (source.topic.as_str(), source.publisher.as_str());
    assert_eq!(name, ("text", "bag"));
    // sm2-ros/oracle compares the hashes of all types with the Python package rosbags.
    let rihs01 = "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8";
    let text = source.schema.unwrap();
    assert!(text.starts_with(&format!("cdr:{rihs01}\n")), "{text}");
}

#[test]
fn a_channel_that_cannot_be_published_has_a_reason() {
    let domain = Domain::new();
    let other = format!("RIHS01_{:064x}", 7);
    for (schema, rihs01, expected) in [
        ((STRING, "ros2idl", ""), "", "schema in \"ros2idl\""),
        ((STRING, "ros2msg", "string\n"), "", "String, line 1"),
        ((STRING, "ros2msg", "Part part\n"), "", "std_msgs/msg/Part"),
        (
            ("String", "ros2msg", ""),
            "",
            "write it as package/msg/Name",
        ),
        ((STRING, "ros2msg", "string data"), &*other, "RIHS01_df668c"),
    ] {
        let path = domain.path("foreign.mcap");
        write_foreign(&path, schema, rihs01);
        let bag = Bag::open(&path).unwrap();
        let shutdown = Shutdown::new().unwrap();
        let error = player(&domain, &bag, &shutdown).err().unwrap();
        assert!(matches!(error, PlayError::Foreign { .. }), "{error:?}");
        let text = error.to_string();
        assert!(
            text.contains("\"/text\"") && text.contains(expected),
            "{text}"
        );
    }
}
