//! `sm2 bag cat`.

use std::fs;

use nix::sys::signal::Signal;
use serde_json::Value;

use crate::bag::{bag, publish_lines};
use crate::common::{Domain, talker, until};

#[test]
fn the_messages_of_a_topic_are_printed_as_echo_does() {
    let domain = Domain::new();
    let path = domain.path("talk.mcap");
    let file = path.to_str().unwrap();
    let recorder = domain.start(&["record", "chatter", "--reliable", "chatter", "-o", file]);
    domain.wait_for("chatter", "subscribers", 1);
    publish_lines(&domain, "one\ntwo\nthree\n");
    recorder.signal(Signal::SIGINT);
    assert_eq!(recorder.finish().code(), 0);
    assert_eq!(
        bag(&["cat", file]),
        (0, "one\ntwo\nthree\n".to_owned(), String::new())
    );
    assert_eq!(bag(&["cat", file, "--count", "2"]).1, "one\ntwo\n");
    assert_eq!(bag(&["cat", file, "--hex", "--count", "1"]).1, "6f6e65\n");
    let (code, lines, _) = bag(&["cat", file, "--json"]);
    assert_eq!(code, 0);
    let lines: Vec<Value> = lines
        .lines()
        .map(|it| serde_json::from_str(it).unwrap())
        .collect();
    let texts: Vec<_> = lines
        .iter()
        .map(|it| it["text"].as_str().unwrap())
        .collect();
    assert_eq!(texts, ["one", "two", "three"]);
    assert!(
        lines
            .iter()
            .all(|it| it["topic"] == "chatter" && it["repeated"] == false)
    );
    // A damaged part is left out, and told.
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes.windows(3).position(|it| it == b"two").unwrap();
    bytes[at] = b'T';
    let damaged = domain.path("damaged.mcap");
    fs::write(&damaged, bytes).unwrap();
    let (code, printed, told) = bag(&["cat", damaged.to_str().unwrap()]);
    assert_eq!((code, printed.contains("Two")), (1, false), "{printed}");
    assert!(told.contains("is damaged, and printed without"), "{told}");
}

#[test]
fn each_message_of_several_topics_has_a_title() {
    let domain = Domain::new();
    let file = domain.path("bag.mcap");
    let file = file.to_str().unwrap();
    let (_scan, scanner) = talker(&domain, "scan");
    let _imu = talker(&domain, "imu");
    let recorder = domain.start(&["record", "scan", "imu", "-o", file, "--sync", "5ms"]);
    let printed = || bag(&["cat", file]).1;
    let title = format!(" scan of {scanner}\nhello\n");
    until("both topics are in the bag", || {
        printed().contains(&title) && printed().contains(" imu of ")
    });
    assert!(printed().starts_with("--- 0"), "{}", printed());
    let (_, one_topic, told) = bag(&["cat", file, "--topic", "scan", "--count", "2"]);
    assert_eq!(one_topic, "hello\nhello\n");
    assert!(told.contains("is incomplete"), "{told}");
    let info = || bag(&["info", file]).1;
    let by = format!(
        "(BEING WRITTEN by node sm2-record-{0}, process {0}, since ",
        recorder.pid()
    );
    assert!(info().contains(&by), "{}", info());
    recorder.signal(Signal::SIGKILL);
    until("the recorder is gone", || info().contains("(INCOMPLETE: "));
}
