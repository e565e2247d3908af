//! A test that waits for ever ends.

use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::{process, thread};

use super::SOON;

/// Ends the process if this value lives for longer than any test takes: the test waits for something that never comes.
pub(crate) struct Limit {
    _until: Sender<()>,
}

impl Limit {
    pub(crate) fn new() -> Self {
        let (until, ended) = mpsc::channel();
        let test = thread::current().name().unwrap_or("a test").to_owned();
        let watch = move || {
            if ended.recv_timeout(10 * SOON) == Err(RecvTimeoutError::Timeout) {
                eprintln!("{test} waits for ever");
                process::exit(1);
            }
        };
        // The test goes on without a limit if there are no threads.
        let _ = thread::Builder::new().name("limit".into()).spawn(watch);
        Self { _until: until }
    }
}
