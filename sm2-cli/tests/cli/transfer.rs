//! `sm2 topic echo` receives the bytes that `sm2 topic pub` publishes.

use std::{fs, io::Write, process::Stdio, thread, time::Duration};

use crate::common::{Domain, Running, SOON, files, noise};

/// Contents from empty to large, text and binary.
fn contents() -> Vec<Vec<u8>> {
    let sizes = [
        0,
        1,
        4_095,
        4_096,
        4_097,
        61_440,
        61_441,
        1 << 20,
        5_000_001,
    ];
    let noises = sizes.iter().zip(1..).map(|(&size, seed)| noise(seed, size));
    let texts = ["hello", "two\nlines\n", "\n", "tabs\tand ünïcödé"];
    noises.chain(texts.map(|text| text.into())).collect()
}

/// Publishes a folder and receives it in another one.
fn folder_to_folder(options: &[&str]) {
    let domain = Domain::new();
    let (from, to) = (domain.path("from"), domain.path("to"));
    fs::create_dir(&from).unwrap();
    let contents = contents();
    for (number, content) in contents.iter().enumerate() {
        fs::write(from.join(format!("{number:03}.dat")), content).unwrap();
    }
    let count = contents.len().to_string();
    let to = to.to_str().unwrap();
    let echo = domain.start(&[
        "topic",
        "echo",
        "/files",
        "--reliable",
        "--count",
        &count,
        "--to-dir",
        to,
    ]);
    let from = from.to_str().unwrap();
    let publish = ["topic", "pub", "files", "--reliable", "--from", from];
    let published = domain.run(&[&publish, options].concat());
    assert_eq!(published.code(), 0, "{}", published.stderr());
    let received = echo.finish();
    assert_eq!(received.code(), 0, "{}", received.stderr());
    assert_eq!(received.stdout(), "");

    let expected: Vec<_> = contents
        .into_iter()
        .enumerate()
        .map(|(number, content)| (format!("{number:06}.bin"), content))
        .collect();
    assert!(files(to.as_ref()) == expected);
    let summary = format!(
        "published {count} messages (6.1 MB) to 1 subscriber: {count} delivered, 0 dropped\n"
    );
    assert_eq!(published.stderr(), summary);
    let summary = format!("received {count} messages (6.1 MB), lost 0\n");
    assert_eq!(received.stderr(), summary);
}

#[test]
fn a_folder_arrives_as_it_was() {
    folder_to_folder(&[]);
}

#[test]
fn a_folder_arrives_sealed_as_it_was() {
    folder_to_folder(&["--integrity", "sealed"]);
}

/// Publishes `input` through standard input, and returns the files that `echo` writes.
fn through(input: &[u8], options: &[&str], count: usize) -> Vec<Vec<u8>> {
    let domain = Domain::new();
    let to = domain.path("to");
    let count = count.to_string();
    let echo = domain.start(&[
        "topic",
        "echo",
        "parts",
        "--reliable",
        "--count",
        &count,
        "--to-dir",
        to.to_str().unwrap(),
    ]);
    let publish = ["topic", "pub", "parts", "--reliable", "--from", "-"];
    let mut command = domain.command(&[&publish, options].concat());
    let mut publish = Running::start(command.stdin(Stdio::piped()));
    let mut stdin = publish.child().stdin.take().unwrap();
    stdin.write_all(input).unwrap();
    drop(stdin);
    let published = publish.finish();
    assert_eq!(published.code(), 0, "{}", published.stderr());
    assert_eq!(echo.finish().code(), 0);
    files(&to).into_iter().map(|(_, content)| content).collect()
}

#[test]
fn standard_input_is_published_by_line() {
    let input = b"first\n\n\xff\xfe binary \0\r\nlast";
    let expected = [&b"first"[..], b"", b"\xff\xfe binary \0\r", b"last"];
    assert_eq!(through(input, &[], 4), expected);
}

#[test]
fn standard_input_is_published_by_chunk() {
    let input = noise(7, 300_000);
    let chunks = through(&input, &["--chunk", "64KiB"], 5);
    assert!(chunks.concat() == input);
    let sizes: Vec<_> = chunks.iter().map(Vec::len).collect();
    assert_eq!(sizes, [65_536, 65_536, 65_536, 65_536, 37_856]);
}

#[test]
fn standard_input_is_published_whole() {
    let input = noise(8, 2_000_000);
    assert!(through(&input, &["--whole"], 1) == [input]);
    assert_eq!(through(b"", &["--whole"], 1), [b""]);
}

#[test]
fn an_input_without_messages_publishes_none() {
    let domain = Domain::new();
    let echo = domain.start(&["topic", "echo", "none"]);
    let empty = domain.path("empty");
    fs::write(&empty, "").unwrap();
    for part in [&["--lines"][..], &["--chunk", "1"]] {
        let from = ["topic", "pub", "none", "--from", empty.to_str().unwrap()];
        let published = domain.run(&[&from[..], part].concat());
        assert_eq!(published.code(), 0);
        assert!(published.stderr().starts_with("published 0 messages"));
    }
    drop(echo);
}

#[test]
fn a_slow_reader_gets_every_line_in_its_order() {
    let domain = Domain::new();
    let lines: String = (0..20_000)
        .map(|number| format!("line {number}\n"))
        .collect();
    let file = domain.path("lines");
    fs::write(&file, &lines).unwrap();
    let echo = domain.start(&["topic", "echo", "lines", "--reliable", "--count", "20000"]);
    let file = file.to_str().unwrap();
    let published = domain.run(&[
        "topic",
        "pub",
        "lines",
        "--from",
        file,
        "--lines",
        "--reliable",
    ]);
    assert_eq!(published.code(), 0, "{}", published.stderr());
    let received = echo.finish();
    assert!(received.stdout() == lines, "{}", received.stderr());
}

/// A subscriber with a window of three messages, which is slower than the publisher.
#[test]
fn a_narrow_subscriber_gets_every_line() {
    let domain = Domain::new();
    let lines: String = (0..300).map(|number| format!("{number}\n")).collect();
    let file = domain.path("lines");
    fs::write(&file, &lines).unwrap();
    let node = domain.node("narrow");
    let builder = node.subscriber_builder::<str>("lines").reliable(true);
    let subscriber = builder.depth(2).max_borrowed(1).declare().unwrap();
    let from = ["topic", "pub", "lines", "--from", file.to_str().unwrap()];
    let publish = domain.start(&[&from[..], &["--lines", "--reliable", "--type", "text"]].concat());
    for number in 0..300 {
        let sample = subscriber.recv_timeout(SOON).unwrap().expect("a line");
        assert_eq!(*sample, *number.to_string());
        if number % 10 == 0 {
            thread::sleep(Duration::from_millis(1));
        }
    }
    let published = publish.finish();
    let summary = published.stderr();
    assert!(summary.ends_with("300 delivered, 0 dropped\n"), "{summary}");
    assert_eq!(published.code(), 0);
}

/// A subscriber whose window admits more than the memory of the publisher holds.
#[test]
fn a_small_pool_loses_nothing() {
    let domain = Domain::new();
    let input = noise(9, 6_000_000);
    let file = domain.path("input");
    fs::write(&file, &input).unwrap();
    let node = domain.node("wide");
    let builder = node.subscriber_builder::<[u8]>("parts").reliable(true);
    let subscriber = builder.depth(100).declare().unwrap();
    let from = ["topic", "pub", "parts", "--from", file.to_str().unwrap()];
    let options = ["--chunk", "100kB", "--pool-limit", "1MiB", "--reliable"];
    let publish = domain.start(&[&from[..], &options].concat());
    let mut received = Vec::new();
    while received.len() < input.len() {
        let sample = subscriber.recv_timeout(SOON).unwrap();
        received.extend_from_slice(&sample.expect("a part"));
        thread::sleep(Duration::from_millis(1));
    }
    assert!(received == input);
    let published = publish.finish();
    let summary = published.stderr();
    assert!(summary.ends_with("60 delivered, 0 dropped\n"), "{summary}");
    assert_eq!(published.code(), 0);
}

#[test]
fn every_subscriber_gets_every_message() {
    let domain = Domain::new();
    let echoes: Vec<_> = (0..3)
        .map(|_| domain.start(&["topic", "echo", "many", "--reliable", "--count", "100"]))
        .collect();
    let file = domain.path("lines");
    let lines: String = (0..100).map(|number| format!("{number}\n")).collect();
    fs::write(&file, &lines).unwrap();
    let from = file.to_str().unwrap();
    let published = domain.run(&[
        "topic",
        "pub",
        "many",
        "--from",
        from,
        "--lines",
        "--reliable",
        "--wait",
        "3",
    ]);
    assert!(
        published
            .stderr()
            .contains("to 3 subscribers: 300 delivered"),
        "{published:?}"
    );
    for echo in echoes {
        assert_eq!(echo.finish().stdout(), lines);
    }
}

#[test]
fn a_file_is_published_again_and_again_at_a_rate() {
    let domain = Domain::new();
    let file = domain.path("file");
    fs::write(&file, "again").unwrap();
    let from = file.to_str().unwrap();
    let publish = domain.start(&[
        "topic", "pub", "again", "--from", from, "--loop", "--rate", "200",
    ]);
    let received = domain.run(&["topic", "echo", "again", "--count", "5"]);
    assert_eq!(received.stdout(), "again\n".repeat(5));
    drop(publish);
}

#[test]
fn messages_are_printed_as_text_hex_and_json() {
    let domain = Domain::new();
    let folder = domain.path("from");
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("1"), "text").unwrap();
    fs::write(folder.join("2"), b"\x00\xff").unwrap();
    fs::write(folder.join("3"), "").unwrap();
    let publish = |topic| {
        let from = folder.to_str().unwrap();
        let published = domain.run(&["topic", "pub", topic, "--from", from, "--reliable"]);
        assert_eq!(published.code(), 0, "{}", published.stderr());
    };
    let echo = |topic, options: &[&str]| {
        let echo = ["topic", "echo", topic, "--reliable", "--count", "3"];
        domain.start(&[&echo, options].concat())
    };
    let plain = echo("plain", &[]);
    publish("plain");
    assert_eq!(plain.finish().stdout(), "text\n2 bytes: 00 ff\n\n");

    let json = echo("json", &["--json"]);
    publish("json");
    let json = json.finish().stdout();
    let lines: Vec<serde_json::Value> = json
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines[0]["text"], "text");
    assert_eq!(lines[0]["topic"], "json");
    assert_eq!(lines[0]["sequence"], 1);
    assert_eq!(lines[1]["hex"], "00ff");
    assert_eq!(lines[1]["len_bytes"], 2);
    assert_eq!(lines[2]["text"], "");
    assert_eq!(lines[2]["lost"], 0);

    let to = domain.path("to");
    let both = echo("both", &["--json", "--to-dir", to.to_str().unwrap()]);
    publish("both");
    let both = both.finish().stdout();
    let last: serde_json::Value = serde_json::from_str(both.lines().last().unwrap()).unwrap();
    assert_eq!(last["file"], to.join("000002.bin").to_str().unwrap());
    assert_eq!(files(&to).len(), 3);
}
