use std::{io, os::fd::AsFd, os::unix::net::UnixStream};

use super::*;
use crate::options::Format;

/// A shell that runs `script` as a process of the demo.
fn shell(part: Part, script: &str) -> Child {
    Child::start(part, Command::new("sh").args(["-c", script])).unwrap()
}

#[test]
fn a_process_that_cannot_start_ends_the_demo_with_its_reason() {
    let options = Options {
        subscribers: 2,
        size_bytes: 100,
        rate_hz: 1.0,
        seconds: 1.0,
        is_sealed: false,
        format: Format::Json,
    };
    let (stop, _held) = UnixStream::pair().unwrap();
    let mut out = io::sink();
    let mut director = Director {
        options: &options,
        count: 1,
        socket: Path::new("none"),
        stop: stop.as_fd(),
        is_stopped: false,
        children: vec![
            shell(Part::Subscriber(1), "echo '\"ready\"'; cat"),
            shell(
                Part::Subscriber(2),
                r#"echo '{"failed":{"reason":"no memory"}}'; cat"#,
            ),
        ],
        screen: Screen::new(&mut out, Format::Json),
    };
    match director.await_ready() {
        Err(DemoError::PartFailed { part, reason }) => {
            assert_eq!((&*part, &*reason), ("subscriber 2", "no memory"));
        }
        other => panic!("{other:?}"),
    }
}
