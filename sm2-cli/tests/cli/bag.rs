//! `sm2 record`, `sm2 play` and `sm2 bag`.

use std::{fs, path::Path};

use nix::sys::signal::Signal;
use serde_json::{Value, json};
use sm2_test_support::Scheduling;

use crate::common::{Domain, Running, sm2, until};

/// Publishes ten lines of text to a recorder.
fn publish(domain: &Domain) {
    let lines: String = (0..10).map(|it| format!("line {it}\n")).collect();
    publish_lines(domain, &lines);
}

/// Publishes a message for each line to a recorder of `chatter`.
pub(crate) fn publish_lines(domain: &Domain, lines: &str) {
    fs::write(domain.path("lines"), lines).unwrap();
    let from = domain.path("lines");
    let text = [
        "topic",
        "pub",
        "chatter",
        "--from",
        from.to_str().unwrap(),
        "--lines",
        "--wait",
        "1",
        "--reliable",
    ];
    let finished = domain.run(&text);
    assert_eq!(finished.code(), 0, "{finished:?}");
}

pub(crate) fn bag(arguments: &[&str]) -> (i32, String, String) {
    let finished = Running::start(&mut sm2(&[&["bag"], arguments].concat())).finish();
    (finished.code(), finished.stdout(), finished.stderr())
}

/// The names and counts of the topics in a summary.
pub(crate) fn counts(summary: &str) -> Value {
    let summary: Value = serde_json::from_str(summary).unwrap();
    let topics = summary["topics"].as_array().unwrap().iter();
    let counts: Vec<_> = topics
        .map(|it| json!([it["name"], it["messages"], it["lost"]]))
        .collect();
    json!([counts, summary["complete"]])
}

#[test]
fn a_recording_is_shown_checked_and_played() {
    let domain = Domain::new();
    let path = domain.path("talk.mcap");
    let file = path.to_str().unwrap();
    let recorder = domain.start(&[
        "record",
        "chatter",
        "--reliable",
        "chatter",
        "-o",
        file,
        "--json",
    ]);
    domain.wait_for("chatter", "subscribers", 1);
    publish(&domain);
    recorder.signal(Signal::SIGINT);
    let finished = recorder.finish();
    assert_eq!(finished.code(), 0, "{finished:?}");
    assert!(
        finished.stderr().contains("talk.mcap (Ctrl-C ends)"),
        "{finished:?}"
    );
    let expected = json!([[["chatter", 10, 0]], true]);
    assert_eq!(counts(&finished.stdout()), expected);

    let (code, info, _) = bag(&["info", file, "--json"]);
    assert_eq!((code, counts(&info)), (0, expected));
    assert_eq!(info, finished.stdout());
    let (code, text, _) = bag(&["info", file]);
    assert_eq!(code, 0);
    assert!(
        text.contains("chatter (bytes): 10 messages, 60 bytes, lost 0"),
        "{text}"
    );
    let (code, text, _) = bag(&["check", file]);
    assert_eq!(code, 0, "{text}");
    assert!(text.ends_with("no damage\n"), "{text}");

    let echo = domain.start(&["topic", "echo", "again", "--reliable", "--count", "10"]);
    domain.wait_for("again", "subscribers", 1);
    let played = domain.json(&[
        "play",
        file,
        "--remap",
        "chatter=again",
        "--rate",
        "0",
        "--wait",
        "1",
    ]);
    let topic = json!({"name": "again", "messages": 10, "unheard": 0, "missed": 0});
    assert_eq!(played, json!({"topics": [topic], "complete": true}));
    let echoed = echo.finish();
    let lines: Vec<_> = (0..10).map(|it| format!("line {it}")).collect();
    let seen: Vec<_> = echoed.stdout().lines().map(str::to_owned).collect();
    assert_eq!(seen, lines);

    // An existing file is not overwritten.
    let again = domain.run(&["record", "chatter", "-o", file]);
    assert_eq!(again.code(), 1);
    assert!(again.stderr().contains("cannot create"), "{again:?}");
}

#[test]
fn a_recording_is_divided_into_the_files_of_a_folder() {
    let domain = Domain::new();
    let path = domain.path("drives");
    let folder = path.to_str().unwrap();
    let options = ["--split-time", "1ns", "--max-size", "1GB", "--json"];
    let arguments = ["record", "chatter", "--reliable", "chatter", "-o", folder];
    let recorder = domain.start(&[&arguments[..], &options].concat());
    domain.wait_for("chatter", "subscribers", 1);
    publish(&domain);
    recorder.signal(Signal::SIGINT);
    let finished = recorder.finish();
    assert_eq!(finished.code(), 0, "{finished:?}");
    let expected = json!([[["chatter", 10, 0]], true]);
    assert_eq!(counts(&finished.stdout()), expected);
    let entries = fs::read_dir(&path).unwrap();
    let mut bags: Vec<_> = entries.map(|it| it.unwrap().path()).collect();
    bags.sort();
    assert!(bags.len() > 1, "{bags:?}");
    let merged = domain.path("merged.mcap");
    let mut merge = vec!["merge"];
    merge.extend(bags.iter().map(|it| it.to_str().unwrap()));
    merge.extend(["-o", merged.to_str().unwrap()]);
    let (code, text, error) = bag(&merge);
    assert_eq!(code, 0, "{text}{error}");
    let (_, info, _) = bag(&["info", merged.to_str().unwrap(), "--json"]);
    assert_eq!(counts(&info), expected);
}

#[test]
fn a_recording_ends_when_the_disk_is_nearly_full() {
    let domain = Domain::new();
    // A file system in memory never has so much room.
    let folder = tempfile::tempdir_in("/dev/shm").unwrap();
    let path = folder.path().join("full.mcap");
    let file = path.to_str().unwrap();
    let recorder = domain.start(&["record", "chatter", "-o", file, "--min-free", "1TiB"]);
    domain.wait_for("chatter", "subscribers", 1);
    publish(&domain);
    let finished = recorder.finish();
    assert_eq!(finished.code(), 1, "{finished:?}");
    let error = finished.stderr();
    assert!(error.contains("the disk is nearly full"), "{error}");
    let (code, text, _) = bag(&["check", file]);
    assert_eq!(code, 0, "{text}");
}

#[test]
fn a_recorder_can_leave_the_processor_to_others() {
    const NORMAL: u32 = 0;
    const IDLE: u32 = 5;
    let domain = Domain::new();
    for (arguments, expected) in [(&[][..], NORMAL), (&["--priority", "idle"][..], IDLE)] {
        let file = domain.path(&format!("priority{expected}.mcap"));
        let file = file.to_str().unwrap();
        let recorder = domain.start(&[&["record", "--all", "-o", file][..], arguments].concat());
        until("the file is there", || Path::new(file).exists());
        let threads = Scheduling::of_process(recorder.pid().unsigned_abs());
        assert!(
            threads.len() > 1 && threads.iter().all(|it| it.policy == expected),
            "{threads:?}"
        );
        recorder.signal(Signal::SIGTERM);
        recorder.finish();
    }
}

/// Records ten messages of `chatter`, and kills the recorder once they are in the file.
fn record_and_kill(domain: &Domain, file: &str) {
    let recorder = domain.start(&["record", "--all", "-o", file, "--sync", "1ms"]);
    until("the file is there", || Path::new(file).exists());
    publish(domain);
    until("all messages are in the file", || {
        let (code, info, _) = bag(&["info", file, "--json"]);
        code == 0 && counts(&info)[0] == json!([["chatter", 10, 0]])
    });
    recorder.signal(Signal::SIGKILL);
    recorder.finish();
}

#[test]
fn a_killed_recording_can_be_read_and_recovered() {
    let domain = Domain::new();
    let path = domain.path("killed.mcap");
    let file = path.to_str().unwrap();
    record_and_kill(&domain, file);
    let (code, text, _) = bag(&["info", file]);
    assert_eq!(code, 0);
    assert!(text.contains("INCOMPLETE"), "{text}");
    let (code, text, _) = bag(&["check", file]);
    assert_eq!(code, 1);
    assert!(
        text.contains("damage: the recording did not end in order"),
        "{text}"
    );
    let played = domain.run(&["play", file, "--rate", "0"]);
    assert_eq!(played.code(), 0, "{played:?}");
    assert!(
        played.stderr().contains("killed.mcap is incomplete"),
        "{played:?}"
    );
    let (code, recovered, _) = bag(&["recover", file, "--json"]);
    assert_eq!(
        (code, counts(&recovered)),
        (0, json!([[["chatter", 10, 0]], true]))
    );
    let whole = domain.path("killed.recovered.mcap");
    assert_eq!(bag(&["check", whole.to_str().unwrap()]).0, 0);
}

/// The messages of a damaged part are missing, which each command says. Everything behind it is there.
#[test]
fn a_damaged_part_costs_its_messages_alone() {
    let domain = Domain::new();
    let path = domain.path("talk.mcap");
    let file = path.to_str().unwrap();
    record_and_kill(&domain, file);
    let [whole, damaged, to] = ["whole", "damaged", "to"].map(|it| domain.path(it));
    let [whole, damaged, to] = [&whole, &damaged, &to].map(|it| it.to_str().unwrap());
    assert_eq!(bag(&["recover", file, "-o", whole]).0, 0);
    let bytes = fs::read(whole).unwrap();
    let at = bytes.windows(6).position(|it| it == b"line 4");
    let mut bytes = bytes;
    bytes[at.unwrap()] = b'!';
    fs::write(damaged, bytes).unwrap();

    let (code, text, _) = bag(&["check", damaged]);
    assert!(code == 1 && text.contains("damage: unreadable: "), "{text}");
    // All lines are in one chunk.
    let expected = json!([[["chatter", 0, 10]], true]);
    for command in [
        &["recover", damaged][..],
        &["filter", damaged, "--topic", "chatter"],
        &["convert", damaged, "--compression", "lz4"],
    ] {
        let (code, summary, told) = bag(&[command, &["-o", to, "--json"]].concat());
        assert_eq!(
            (code, counts(&summary)),
            (1, expected.clone()),
            "{command:?}: {told}"
        );
        let summary: Value = serde_json::from_str(&summary).unwrap();
        assert_eq!(summary["topics"][0]["gaps"][0]["reason"], "damaged");
        assert_eq!(summary["damaged"].as_array().unwrap().len(), 1);
        let (code, text, _) = bag(&["info", to]);
        assert!(
            code == 0 && text.contains("left out as damaged: "),
            "{text}"
        );
        fs::remove_file(to).unwrap();
    }
    let (code, summary, _) = bag(&["merge", whole, damaged, "-o", to, "--json"]);
    assert_eq!(
        (code, counts(&summary)),
        (1, json!([[["chatter", 10, 10]], true]))
    );
    fs::remove_file(to).unwrap();
    // The damage of each bag is its own, also if both are one file.
    let (code, summary, _) = bag(&["merge", damaged, damaged, "-o", to, "--json"]);
    assert_eq!(
        (code, counts(&summary)),
        (1, json!([[["chatter", 0, 20]], true]))
    );
    let (code, _, told) = bag(&["diff", damaged, damaged]);
    assert!(
        code == 1 && told.contains("is damaged, and compared without"),
        "{told}"
    );
    let played = domain.run(&["play", whole, damaged, "--rate", "0", "--json"]);
    let report: Value = serde_json::from_str(&played.stdout()).unwrap();
    assert_eq!(played.code(), 1, "{played:?}");
    assert_eq!(report["topics"][0]["messages"], 10);
    assert_eq!(report["damaged"].as_array().unwrap().len(), 1);
}

#[test]
fn copies_have_the_chosen_messages() {
    let domain = Domain::new();
    let path = domain.path("talk.mcap");
    let file = path.to_str().unwrap();
    record_and_kill(&domain, file);

    let new = |name: &str| domain.path(name).to_str().unwrap().to_owned();
    let [small, part, both] = [new("small.mcap"), new("part.mcap"), new("both.mcap")];
    let zstd = ["--compression", "zstd", "-o", &small, "--json"];
    let (code, summary, told) = bag(&[&["convert", file], &zstd[..]].concat());
    assert_eq!(
        (code, counts(&summary)),
        (0, json!([[["chatter", 10, 0]], true]))
    );
    assert!(told.contains("talk.mcap is incomplete: copying"), "{told}");
    let (code, summary, told) = bag(&["merge", &small, &small, "-o", &both, "--json"]);
    assert_eq!(
        (code, counts(&summary)),
        (0, json!([[["chatter", 20, 0]], true]))
    );
    assert_eq!(told, "");
    let (code, text, _) = bag(&["filter", &small, "--end", "1ns", "-o", &part]);
    assert_eq!(code, 0);
    assert!(
        text.contains("chatter (bytes): 1 message, 6 bytes"),
        "{text}"
    );
    for whole in [&small, &part, &both] {
        assert_eq!(bag(&["check", whole]).0, 0, "{whole}");
    }

    let (code, _, told) = bag(&["filter", &small, "--topic", "scan", "-o", &new("scan.mcap")]);
    assert_eq!(code, 1);
    assert!(told.contains("no bag has a topic \"scan\""), "{told}");
    let (code, _, told) = bag(&["filter", &small, "-o", &small]);
    assert_eq!(code, 1);
    assert!(told.contains("cannot write"), "{told}");
    assert_eq!(bag(&["merge", &small, "-o", &new("one.mcap")]).0, 2);
    assert_eq!(bag(&["convert", &small, "-o", &new("same.mcap")]).0, 2);
}

#[test]
fn bags_are_listed_and_compared() {
    let domain = Domain::new();
    let new = |name: &str| domain.path(name).to_str().unwrap().to_owned();
    let [first, part] = [new("first.mcap"), new("part.mcap")];
    let recorder = domain.start(&[
        "record",
        "chatter",
        "--reliable",
        "chatter",
        "-o",
        &first,
        "--json",
    ]);
    domain.wait_for("chatter", "subscribers", 1);
    publish(&domain);
    recorder.signal(Signal::SIGINT);
    assert_eq!(recorder.finish().code(), 0);
    assert_eq!(bag(&["filter", &first, "--end", "1ns", "-o", &part]).0, 0);

    let (code, text, _) = bag(&["diff", &first, &first]);
    assert_eq!((code, &*text), (0, "the payloads are the same\n"));
    assert_eq!(bag(&["diff", &first, &first, "--json"]).1, "null\n");
    let (code, text, _) = bag(&["diff", &part, &first]);
    let expected = "only the second bag has message 1 of chatter\n";
    assert_eq!((code, &*text), (1, expected));
    let (_, text, _) = bag(&["diff", &first, &part, "--json"]);
    let difference: Value = serde_json::from_str(&text).unwrap();
    let expected = json!({"difference": "count", "topic": "chatter", "message": 1, "only_in": 0});
    assert_eq!(difference, expected);

    let folder = new("");
    let (code, text, _) = bag(&["ls", &folder]);
    assert_eq!(code, 0);
    let rows = text.lines().map(|it| it.split_whitespace().collect());
    let rows: Vec<Vec<_>> = rows.collect();
    assert_eq!(rows.len(), 3, "{text}");
    assert_eq!(rows[1][0], first);
    assert_eq!(rows[1][rows[1].len() - 4..], ["1", "10", "0", "complete"]);
    assert_eq!(rows[2][0], part);
    fs::write(domain.path("wrong.mcap"), "a letter").unwrap();
    let (code, text, told) = bag(&["ls", &folder, "--json"]);
    assert_eq!(code, 1);
    assert!(told.contains("wrong.mcap is not an MCAP file"), "{told}");
    let listed: Value = serde_json::from_str(&text).unwrap();
    let messages: Vec<_> = listed["bags"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| &it["messages"])
        .collect();
    assert_eq!(messages, [10, 1]);
    let (code, _, told) = bag(&["ls", &new("nowhere")]);
    assert_eq!(code, 1);
    assert!(told.contains("cannot read the folder"), "{told}");
}

#[test]
fn wrong_use_is_told() {
    let domain = Domain::new();
    let refused = domain.run(&["record", "chatter", "--reliable", "scan"]);
    assert_eq!(refused.code(), 2);
    assert!(
        refused
            .stderr()
            .contains("--reliable scan is not among the topics"),
        "{refused:?}"
    );
    let neither = domain.run(&["record"]);
    assert_eq!(neither.code(), 2, "{neither:?}");
    let path = domain.path("text");
    fs::write(&path, "no bag").unwrap();
    for arguments in [&["info"][..], &["check"], &["recover"]] {
        let (code, _, error) = bag(&[arguments, &[path.to_str().unwrap()]].concat());
        assert_eq!(code, 1);
        assert!(error.contains("text is not an MCAP file"), "{error}");
    }
    let absent = domain.run(&["play", "absent.mcap"]);
    assert_eq!(absent.code(), 1);
    assert!(
        absent.stderr().contains("cannot read absent.mcap"),
        "{absent:?}"
    );
}

#[test]
fn a_topic_that_the_policy_denies_does_not_end_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let policy = folder.path().join("policy.toml");
    let rule = "default = \"allow\"\n[[rule]]\neffect = \"deny\"\nactions = [\"subscribe\"]\nnames = [\"secret\"]\n";
    fs::write(&policy, rule).unwrap();
    let domain = Domain::with(&["--policy", policy.to_str().unwrap()]);
    let node = domain.node("talker");
    let _secret = node.publisher::<str>("secret").unwrap();
    let path = domain.path("all.mcap");
    let recorder = domain.start(&["record", "--all", "-o", path.to_str().unwrap(), "--json"]);
    until("the topic is refused", || {
        recorder.stderr().contains("the topic is not recorded")
    });
    publish(&domain);
    recorder.signal(Signal::SIGTERM);
    let finished = recorder.finish();
    // It is named, and the status tells that it is missing.
    assert_eq!(finished.code(), 1, "{finished:?}");
    assert_eq!(
        counts(&finished.stdout()),
        json!([[["chatter", 10, 0]], true])
    );
    let summary: Value = serde_json::from_str(&finished.stdout()).unwrap();
    assert_eq!(summary["missing"][0]["topic"], "secret");
}
