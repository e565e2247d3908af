//! A bag that another program wrote: `tests/bags/rosbag2_0.mcap` is from the Python package `rosbags` 0.11.9, in the
//! format of rosbag2 version 9.

use std::{
    fs,
    path::{Path, PathBuf},
};

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

/// A folder as a recorder of ROS 2 leaves it.
fn folder(domain: &Domain) -> PathBuf {
    let folder = domain.path("drive");
    fs::create_dir(&folder).unwrap();
    fs::copy(PATH, folder.join("drive_0.mcap")).unwrap();
    fs::copy(PATH, folder.join("drive_1.mcap")).unwrap();
    let yaml = "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n  relative_file_paths:\n    \
                - drive_0.mcap\n    - drive_1.mcap\n";
    fs::write(folder.join("metadata.yaml"), yaml).unwrap();
    folder
}

#[test]
fn a_folder_of_rosbag2_is_a_bag_for_all_commands() {
    let domain = Domain::new();
    let folder = folder(&domain);
    let path = folder.to_str().unwrap();
    let all = json!([[["/chatter", 6, 0], ["/robot/point", 2, 0]], true]);
    let (code, info, _) = bag(&["info", path, "--json"]);
    assert_eq!((code, counts(&info)), (0, all.clone()));
    let (code, text, _) = bag(&["check", path]);
    assert!(code == 0 && text.ends_with("no damage\n"), "{text}");
    let (_, text, _) = bag(&["check", path, "--json"]);
    let checked: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(checked["files"].as_array().unwrap().len(), 2, "{text}");
    let (code, lines, _) = bag(&["cat", path, "--topic", "chatter", "--json"]);
    assert_eq!((code, lines.lines().count()), (0, 6), "{lines}");
    let (_, listed, _) = bag(&["ls", domain.path("").to_str().unwrap(), "--json"]);
    let listed: Value = serde_json::from_str(&listed).unwrap();
    assert_eq!(listed["bags"][0]["messages"], json!(8), "{listed}");
    for command in ["filter", "convert", "recover"] {
        let new = domain.path(command);
        let new = new.to_str().unwrap();
        let options: &[_] = match command {
            "convert" => &["--compression", "zstd"],
            _ => &[],
        };
        let (code, text, errors) = bag(&[&[command, path, "-o", new, "--json"], options].concat());
        assert_eq!(
            (code, counts(&text)),
            (0, all.clone()),
            "{command}: {errors}"
        );
        let (code, text, _) = bag(&["diff", path, new]);
        assert_eq!(code, 0, "{command}: {text}");
    }
    let merged = domain.path("merged");
    let merge = [
        "merge",
        path,
        PATH,
        "--json",
        "-o",
        merged.to_str().unwrap(),
    ];
    let (code, text, _) = bag(&merge);
    let sum = json!([[["/chatter", 9, 0], ["/robot/point", 3, 0]], true]);
    assert_eq!((code, counts(&text)), (0, sum));
    let played = domain.json(&["play", path, "--rate", "0"]);
    assert_eq!(played["topics"][0]["messages"], json!(6), "{played}");

    assert_faults_are_told(&folder, &all);
}

/// Faults of a folder, whose topics have these counts.
fn assert_faults_are_told(folder: &Path, all: &Value) {
    let path = folder.to_str().unwrap();
    // One file is damaged: the others are whole.
    let mut bytes = fs::read(PATH).unwrap();
    let middle = bytes.len() / 4;
    bytes[middle] ^= 1;
    fs::write(folder.join("drive_1.mcap"), bytes).unwrap();
    let (code, text, _) = bag(&["check", path]);
    assert!(code == 1 && text.contains("drive_1.mcap: "), "{text}");
    // A description that is of no use, and no description.
    fs::write(
        folder.join("metadata.yaml"),
        "storage_identifier: sqlite3\n",
    )
    .unwrap();
    let (code, _, error) = bag(&["info", path]);
    assert!(code == 1 && error.contains("ros2 bag convert"), "{error}");
    fs::remove_file(folder.join("metadata.yaml")).unwrap();
    fs::copy(PATH, folder.join("drive_1.mcap")).unwrap();
    let (code, info, _) = bag(&["info", path, "--json"]);
    assert_eq!((code, &counts(&info)), (0, all));
    let empty = folder.join("empty");
    fs::create_dir(&empty).unwrap();
    let (code, _, error) = bag(&["info", empty.to_str().unwrap()]);
    assert!(code == 1 && error.contains("has no bag"), "{error}");
}

/// The records of a recording of one message, during which the clock was corrected by 100 s.
pub(crate) fn corrected_recording() -> Vec<u8> {
    let text = |text: &str| [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
    let record = |opcode: u8, body: &[u8]| {
        let len = (body.len() as u64).to_le_bytes();
        [&[opcode][..], &len, body].concat()
    };
    let clock = |monotonic: &str, wall: &str| {
        let pairs = [("monotonic_ns", monotonic), ("wall_ns", wall)];
        let map = pairs.map(|(key, value)| [text(key), text(value)].concat());
        let map = map.concat();
        let len = (map.len() as u32).to_le_bytes();
        record(12, &[text("sm2.clock"), len.to_vec(), map].concat())
    };
    let channel = [&[1, 0, 0, 0][..], &text("data"), &text(""), &[0; 4]].concat();
    let times = [7_u64, 7].map(u64::to_le_bytes).concat();
    let message = [&[1, 0, 0, 0, 0, 0][..], &times, b"hello"].concat();
    let magic = b"\x89MCAP0\r\n";
    [
        magic.to_vec(),
        record(1, &[0; 8]),
        clock("5", "6"),
        record(4, &channel),
        record(5, &message),
        clock("1005", "100000001006"),
        record(15, &[0; 4]),
        record(2, &[0; 20]),
        magic.to_vec(),
    ]
    .concat()
}

#[test]
fn a_recording_gets_the_times_of_the_corrected_clock() {
    let domain = Domain::new();
    let [old, new] = ["old.mcap", "new.mcap"].map(|it| domain.path(it));
    fs::write(&old, corrected_recording()).unwrap();
    let [old, new] = [&old, &new].map(|it| it.to_str().unwrap());
    let (code, text, error) = bag(&["restamp", old, "-o", new]);
    assert_eq!(code, 0, "{error}");
    assert!(text.contains("all times are 100 s later"), "{text}");
    let (_, line, _) = bag(&["cat", new, "--json"]);
    let line: Value = serde_json::from_str(&line).unwrap();
    assert_eq!(line["log_time_ns"], json!(100_000_000_007_u64), "{line}");
    assert_eq!(bag(&["check", new]).0, 0);
    // Nothing is overwritten, and nothing is left to correct.
    let (code, _, error) = bag(&["restamp", old, "-o", new]);
    assert!(code == 1 && error.contains("exists"), "{error}");
    let (code, _, error) = bag(&["restamp", new, "-o", old]);
    assert!(code == 1 && error.contains("was not corrected"), "{error}");
}

#[test]
fn times_of_a_bag_without_a_clock_are_not_corrected() {
    let domain = Domain::new();
    let new = domain.path("new");
    let (code, _, error) = bag(&["restamp", PATH, "-o", new.to_str().unwrap()]);
    assert!(code == 1 && error.contains("sm2.clock"), "{error}");
    assert!(!new.exists());
}
