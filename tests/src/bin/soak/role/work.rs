//! The parts that all roles share.

use std::{
    error::Error,
    thread,
    time::{Duration, Instant},
};

use sm2_node::{Node, diagnostics::LinkStatus};
use sm2_tests::{TIMEOUT, random::Random};

use crate::tally::Tally;

/// The interfaces of one process.
pub(super) trait Work {
    /// Works for a moment, at most a few milliseconds.
    fn turn(&mut self, tally: &mut Tally);

    /// Stops sending, or sends again.
    fn set_resting(&mut self, resting: bool);

    /// Whether each message that it sent is settled, while it rests.
    fn is_settled(&mut self) -> bool;

    /// The links of its interfaces, past ones too.
    fn links(&self) -> Vec<LinkStatus>;
}

/// Connects. Managers die at any moment, and the name of a node that died may still be taken.
pub(super) fn connect(name: &str, socket: &str) -> Node {
    patient("a session", || {
        let builder = Node::builder(name).socket(socket);
        let builder = builder.manager_timeout(TIMEOUT);
        builder.startup_timeout(TIMEOUT).connect()
    })
}

/// Tries until it succeeds: this process may be short of descriptors or memory for a while.
pub(super) fn patient<T, E: Error>(what: &str, mut attempt: impl FnMut() -> Result<T, E>) -> T {
    let start = Instant::now();
    loop {
        match attempt() {
            Ok(done) => return done,
            Err(error) if start.elapsed() > TIMEOUT => panic!("no {what}: {error}"),
            Err(_) => thread::sleep(Duration::from_millis(20)),
        }
    }
}

/// A length between `least` and `most`; short ones are as frequent as long ones.
pub(super) fn random_len(random: &mut Random, least: usize, most: usize) -> usize {
    let most = random.within(least as u64..most as u64 + 1);
    random.within(least as u64..most + 1) as usize
}
