//! A bag that another program wrote: `tests/bags/rosbag2_0.mcap` is from the Python package `rosbags` 0.11.9, in the
//! format of rosbag2 version 9.

use serde_json::{Value, json};

use crate::bag::{bag, counts};
use crate::common::{Domain, until};

const PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/bags/rosbag2_0.mcap");

#[test]
fn a_bag_of_rosbag2_is_shown_and_played() {
    let (code, info, _) = bag(&["info", PATH, "--json"]);
    let expected = json!([[["/chatter", 3, 0], ["/robot/point", 1, 0]], true]);
    assert_eq!((code, counts(&info)), (0, expected));
    let (code, info, _) = bag(&["info", PATH]);
    assert!(
        code == 0 && info.contains("geometry_msgs/msg/PointStamped"),
        "{info}"
    );
    assert_eq!(bag(&["check", PATH]).0, 0);

    let domain = Domain::new();
    let echo = |topic, count| {
        let options = ["--reliable", "--json", "--count", count];
        domain.start(&[&["topic", "echo", topic], &options[..]].concat())
    };
    let echoes = [echo("chatter", "3"), echo("robot/point", "1")];
    let play = ["play", PATH, "--rate", "0", "--wait", "1"];
    let played = domain.json(&play);
    let topics = played["topics"].as_array().unwrap().iter();
    let topics: Vec<_> = topics.map(|it| (&it["name"], &it["messages"])).collect();
    let expected = [
        (json!("chatter"), json!(3)),
        (json!("robot/point"), json!(1)),
    ];
    assert_eq!(
        topics,
        expected.each_ref().map(|(name, count)| (name, count))
    );
    let lines = echoes.map(|echo| {
        let lines = echo.finish().stdout();
        let lines = lines.lines().map(|it| serde_json::from_str(it).unwrap());
        lines.collect::<Vec<Value>>()
    });
    let values = |lines: &[Value]| {
        lines
            .iter()
            .map(|it| it["value"].clone())
            .collect::<Vec<_>>()
    };
    let texts = ["hello", "", "three"].map(|it| json!({ "data": it }));
    assert_eq!(values(&lines[0]), texts);
    assert_eq!(lines[0][0]["publisher"], "play/bag");
    let point = json!({
        "header": { "stamp": { "sec": 1, "nanosec": 2 }, "frame_id": "map" },
        "point": { "x": 1.5, "y": -2.0, "z": 0.0 },
    });
    assert_eq!(values(&lines[1]), [point]);
}

/// The recorded publisher of one topic was transient local: a subscriber that comes late gets its messages, too.
#[test]
fn a_played_topic_is_latched_as_it_was_recorded() {
    let domain = Domain::new();
    let _play = domain.start(&[
        "play", PATH, "--topic", "chatter", "--loop", "--rate", "0.000001",
    ]);
    until("the first message is published", || {
        domain.list("topic")["topics"]
            .as_array()
            .unwrap()
            .iter()
            .any(|it| it["name"] == "chatter")
    });
    let late = domain.run(&["topic", "echo", "chatter", "--count", "1"]);
    assert_eq!(late.stdout(), "{data: \"hello\"}\n", "{late:?}");
}
