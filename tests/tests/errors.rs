//! Errors print their cause once, in one line, however a program prints them.

use std::{error::Error, io, path::Path, time::Duration};

use anyhow::Context as _;
use sm2_gateway::{config::Config, keys};
use sm2_manager::{Background, Options, PolicyFile};
use sm2_node::{Executor, Node, Timer, executor::ExecutorError};

const MISSING: &str = "/no/such/folder/file";

/// The line that `{e}` prints. Panics if a printer of the whole chain would print something twice.
#[track_caller]
fn printed<E: Error + Send + Sync + 'static>(error: E) -> String {
    let line = error.to_string();
    let mut before = line.clone();
    let mut next = error.source();
    while let Some(cause) = next {
        let text = cause.to_string();
        assert!(!before.contains(&text), "{before:?} contains {text:?}");
        (before, next) = (text, cause.source());
    }
    assert_eq!(format!("{:#}", anyhow::Error::from(error)), line);
    line
}

fn missing() -> String {
    io::Error::from_raw_os_error(nix::libc::ENOENT).to_string()
}

#[test]
fn the_reason_of_the_system_is_printed_once() {
    let missing = missing();
    let path = Path::new(MISSING);
    let no_manager = Node::builder("n").socket(path).connect().unwrap_err();
    let cause = no_manager.os_error().and_then(io::Error::raw_os_error);
    assert_eq!(cause, Some(nix::libc::ENOENT));
    let policy_file = Some(path.to_owned());
    let socket = tempfile::tempdir().unwrap();
    let options = Options {
        policy_file,
        ..Options::default()
    };
    let manager = Background::start(&socket.path().join("sm2.sock"), options);
    for line in [
        printed(no_manager),
        printed(manager.map(drop).unwrap_err()),
        printed(PolicyFile::load(path).map(drop).unwrap_err()),
        printed(Config::load(path).map(drop).unwrap_err()),
        printed(keys::load(path).map(drop).unwrap_err()),
    ] {
        assert_eq!(line.matches(&missing).count(), 1, "{line}");
        assert_eq!(line.lines().count(), 1, "{line}");
    }
}

#[test]
fn the_reason_of_a_parser_is_printed_once() {
    let path = Path::new("gateway.toml");
    for text in ["listen = \n", "listen = 'nowhere'\n", "name = ' '\n"] {
        let line = printed(Config::parse(path, text).map(drop).unwrap_err());
        assert!(line.starts_with("gateway.toml:1: "), "{line}");
        assert_eq!(line.lines().count(), 1, "{line}");
    }
}

#[test]
fn the_error_of_a_callback_is_printed_with_all_its_causes() {
    let mut executor = Executor::new().unwrap();
    let group = executor.group(());
    group.on_tick(Timer::once(Duration::ZERO), |(), _| {
        let read = std::fs::read(MISSING).map(drop);
        Ok(read.context("no map").context("no plan")?)
    });
    let error = executor.run().unwrap_err();
    let ExecutorError::Callback { error: cause, .. } = &error else {
        panic!("{error:?}");
    };
    assert_eq!(cause.to_string(), "no plan");
    let line = printed(error);
    let text = format!("failed: no plan: no map: {}", missing());
    assert!(line.ends_with(&text), "{line}");
}
