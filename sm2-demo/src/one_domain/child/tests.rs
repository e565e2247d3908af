use std::path::Path;

use sm2_test_support::{SOON, until};

use super::*;
use crate::waiting::readable;

/// A shell that runs `script` as a process of the demo, in `folder`.
fn start(folder: &Path, script: &str) -> Child {
    let mut command = Command::new("sh");
    command.args(["-c", script]).current_dir(folder);
    Child::start(Part::Subscriber(2), &mut command).unwrap()
}

/// The command that sends an event.
fn say(event: &ProcessEvent) -> String {
    format!("echo '{}'", serde_json::to_string(event).unwrap())
}

fn figures(messages: u64) -> Figures {
    Figures {
        messages,
        ..Figures::default()
    }
}

/// Reads until the process has come so far.
fn read(child: &mut Child, is_so: impl Fn(&Child) -> bool) {
    until("the next event of a process", || {
        if let Some(fd) = child.output_fd() {
            let ready = readable(&[fd], Some(SOON)).unwrap();
            assert_eq!(ready, [true], "the process says nothing");
            child.read_output();
        }
        is_so(child)
    });
}

#[test]
fn a_process_starts_when_it_is_told_and_reports_what_it_does() {
    let folder = tempfile::tempdir().unwrap();
    let script = [
        &say(&ProcessEvent::Ready),
        "read line; [ \"$line\" = start ] || exit 9",
        &say(&ProcessEvent::Progress(figures(3))),
        &say(&ProcessEvent::Done(figures(7))),
        "cat",
    ];
    let mut child = start(folder.path(), &script.join("\n"));
    assert_eq!(child.stage(), &Stage::Starting);
    read(&mut child, |it| *it.stage() == Stage::Ready);
    child.begin();
    read(&mut child, |it| it.figures() == figures(7));
    assert_eq!(child.stage(), &Stage::Done(figures(7)));
    child.end();
    read(&mut child, |it| it.output_fd().is_none());
    let outcome = child.outcome();
    assert_eq!(outcome.part.to_string(), "subscriber 2");
    assert_eq!(outcome.figures, figures(7));
    assert_eq!(
        outcome.stage,
        &Stage::Done(figures(7)),
        "the end comes after the report"
    );
}

#[test]
fn a_line_may_come_in_pieces_and_several_lines_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = start(folder.path(), "cat");
    child.read_events(b"\"rea");
    assert_eq!(child.stage(), &Stage::Starting);
    child.read_events(b"dy");
    child.read_events(b"\"");
    assert_eq!(child.stage(), &Stage::Starting);
    child.read_events(b"\n");
    assert_eq!(child.stage(), &Stage::Ready);
    let [one, two] = [1, 2].map(|it| {
        let event = ProcessEvent::Progress(figures(it));
        serde_json::to_string(&event).unwrap()
    });
    child.read_events(format!("{one}\n{two}\n{{\"failed\":").as_bytes());
    assert_eq!(
        (child.stage(), child.figures()),
        (&Stage::Ready, figures(2))
    );
    child.read_events(b"{\"reason\":\"no memory\"}}\n");
    assert_eq!(child.stage(), &Stage::Failed("no memory".into()));
    child.read_events(b"nonsense\n");
    let Stage::Failed(reason) = child.stage() else {
        panic!("{:?}", child.stage());
    };
    assert!(reason.starts_with("sent an invalid line: "), "{reason}");
}

#[test]
fn a_process_that_ends_before_its_time_has_failed() {
    let folder = tempfile::tempdir().unwrap();
    let ready = say(&ProcessEvent::Ready);
    for (script, reason) in [
        ("exit 3".to_owned(), "ended too early (exit status: 3)"),
        (
            format!("{ready}\nexit 4"),
            "ended too early (exit status: 4)",
        ),
        (
            "kill -9 $$".to_owned(),
            "ended too early (signal: 9 (SIGKILL))",
        ),
    ] {
        let mut child = start(folder.path(), &script);
        read(&mut child, |it| it.output_fd().is_none());
        assert_eq!(child.stage(), &Stage::Failed(reason.into()), "{script}");
    }
}

/// A process that is done ends by itself, and may need a moment. All others are killed.
#[test]
fn only_a_process_that_is_done_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let left = folder.path().join("left");
    let rest = "cat\nsleep 0.2\ntouch left";
    for is_done in [true, false] {
        let event = match is_done {
            true => ProcessEvent::Done(figures(1)),
            false => ProcessEvent::Ready,
        };
        let mut child = start(folder.path(), &format!("{}\n{rest}", say(&event)));
        read(&mut child, |it| *it.stage() != Stage::Starting);
        let process = format!("/proc/{}", child.pid());
        drop(child);
        assert_eq!(left.exists(), is_done);
        assert!(!Path::new(&process).exists(), "nobody waited for its end");
        let _ = std::fs::remove_file(&left);
    }
}
