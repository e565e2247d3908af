//! Messages that are longer than a subscriber accepts.

use nix::sys::signal::Signal;
use serde_json::json;

use crate::bag::{bag, counts, publish_lines};
use crate::common::{Domain, until};

/// A subscriber of 1,024 bytes gets none of these messages; `loss` and `why` say so.
//= SM2-QOS-008 sys
#[test]
fn what_a_subscriber_does_not_accept_is_shown() {
    let domain = Domain::new();
    let value = format!("\"{}\"", "x".repeat(2_000));
    let echo = domain.start(&["topic", "echo", "scan", "--max-len", "1KiB"]);
    domain.wait_for("scan", "subscribers", 1);
    let publish = ["topic", "pub", "scan", "--value", &value, "--rate", "200"];
    let talker = domain.start(&[&publish[..], &["--loop"]].concat());
    domain.wait_for("scan", "publishers", 1);
    let too_long = |row: &serde_json::Value| row["too_long"].as_u64() > Some(0);
    until("messages are dropped", || {
        let loss = domain.json(&[
            "topic",
            "loss",
            "scan",
            "--count",
            "1",
            "--interval",
            "20ms",
        ]);
        let link = &loss["links"][0];
        too_long(link) && link["too_long"] == link["offered"]
    });
    let names = [("pub", talker.pid()), ("echo", echo.pid())];
    let [talker_name, echo_name] = names.map(|(role, pid)| format!("sm2-{role}-{pid}"));
    for arguments in [&["why", &*talker_name, &*echo_name][..], &["why", "scan"]] {
        let why = domain.run(arguments);
        let text = why.stdout();
        assert!(
            text.contains(&format!("But {echo_name}:scan did not get ")),
            "{text}"
        );
        assert!(text.contains("raise max_len of the subscriber, or split the messages.\n"));
        assert_eq!(why.code(), 0);
    }
    let why = domain.json(&["why", "scan"]);
    assert!(why["too_long"][0]["messages"].as_u64() > Some(0), "{why}");
    assert_eq!(echo.stdout(), "");
}

//= SM2-QOS-008 sys
#[test]
fn a_reliable_publication_that_is_too_long_fails() {
    let domain = Domain::new();
    let echo = ["topic", "echo", "scan", "--reliable", "--count", "1"];
    let echo = domain.start(&[&echo[..], &["--max-len", "1KiB"]].concat());
    domain.wait_for("scan", "subscribers", 1);
    let publish = |len: usize| {
        let value = format!("\"{}\"", "x".repeat(len));
        domain.run(&["topic", "pub", "scan", "--reliable", "--value", &value])
    };
    let long = publish(1_025);
    assert_eq!(long.code(), 1);
    let reason = "missed 1 message, longer than they accept: raise their max_len";
    assert!(long.stderr().contains(reason), "{long:?}");
    let summary = "0 delivered, 1 dropped (1 longer than their subscribers accept)";
    assert!(long.stderr().contains(summary), "{long:?}");
    assert_eq!(publish(1_024).code(), 0);
    assert_eq!(echo.finish().code(), 0);
}

/// The recorder itself leaves the messages out, so that it knows their number.
#[test]
fn a_recording_counts_what_is_too_long() {
    let domain = Domain::new();
    let lines = ["x".repeat(2_000), "short".to_owned(), "x".repeat(2_000)];
    for is_allowed in [false, true] {
        let path = domain.path(&format!("bag-{is_allowed}.mcap"));
        let file = path.to_str().unwrap();
        let record = ["record", "chatter", "--max-len", "1KiB", "--sync", "5ms"];
        let more = ["--reliable", "chatter", "--json", "-o", file];
        let allow = ["--allow-missing"];
        let allow = if is_allowed { &allow[..] } else { &[] };
        let recorder = domain.start(&[&record[..], &more, allow].concat());
        publish_lines(&domain, &(lines.join("\n") + "\n"));
        recorder.await_stderr("longer than the recorder takes");
        until("the messages are in the bag", || {
            bag(&["info", file]).1.contains("lost 2")
        });
        recorder.signal(Signal::SIGINT);
        let finished = recorder.finish();
        assert_eq!(finished.code(), i32::from(!is_allowed), "{finished:?}");
        let summary = finished.stdout();
        let expected = json!([[["chatter", 1, 2]], true]);
        assert_eq!(counts(&summary), expected, "{summary}");
        assert!(summary.contains("\"reason\":\"too_long\""), "{summary}");
        let (code, text, _) = bag(&["info", file]);
        let line = "they were longer than --max-len";
        assert!(code == 0 && text.contains(line), "{text}");
    }
}
