//! The threads that publish and receive.
#![allow(
    clippy::disallowed_types,
    reason = "a flag between two threads; no process shares this memory"
)]

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use sm2_io::clock;
use sm2_node::{Node, RecvError};
use sm2_proto::Instant;

use crate::{error::DemoError, pattern};

/// The topic of the demo.
pub(crate) const TOPIC: &str = "camera";
/// How often a thread checks whether to end.
const LOOK: Duration = Duration::from_millis(100);

/// The state that all threads share.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    pub(crate) stop: AtomicBool,
    /// The time when each message was published.
    sent: Mutex<BTreeMap<u64, Instant>>,
}

/// A received message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// The time when it arrived.
    pub(crate) at: Instant,
    /// The time since its publication, in nanoseconds.
    pub(crate) age_ns: u64,
    /// The number of the message.
    pub(crate) number: u64,
    /// True if a byte differs from the sent one.
    pub(crate) damaged: bool,
}

/// The messages that a subscriber has received so far.
pub(crate) type Log = Arc<Mutex<Vec<Seen>>>;

/// Starts a thread that publishes until the demo ends.
pub(crate) fn publish(
    node: Node,
    shared: Arc<Shared>,
    size_bytes: usize,
    period: Duration,
) -> Result<JoinHandle<Result<(), DemoError>>, DemoError> {
    let publisher = node
        .publisher_builder::<[u8]>(TOPIC)
        .depth(1)
        .declare()
        .map_err(DemoError::node)?;
    let publish = move || {
        let mut next = clock::now();
        for number in 0.. {
            while clock::now() < next {
                thread::sleep(next.since(clock::now()));
            }
            if shared.stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let mut loan = publisher.loan_slice(size_bytes).map_err(DemoError::node)?;
            pattern::fill(number, &mut loan);
            lock(&shared.sent).insert(number, clock::now());
            loan.publish().map_err(DemoError::node)?;
            next = next.after(period);
        }
        Ok(())
    };
    start(publish)
}

/// Starts a thread that receives until the demo ends.
pub(crate) fn subscribe(
    node: &Node,
    shared: Arc<Shared>,
    depth: u16,
) -> Result<(Log, JoinHandle<Result<(), DemoError>>), DemoError> {
    let subscriber = node
        .subscriber_builder::<[u8]>(TOPIC)
        .depth(depth)
        .declare()
        .map_err(DemoError::node)?;
    let log = Log::default();
    let ours = Arc::clone(&log);
    let subscribe = move || {
        while !shared.stop.load(Ordering::Relaxed) {
            let sample = match subscriber.recv_timeout(LOOK) {
                Ok(Some(sample)) => sample,
                Ok(None) => continue,
                Err(error @ RecvError::Map { .. }) => return Err(DemoError::node(error)),
                Err(_) => continue,
            };
            let at = clock::now();
            let checked = pattern::check(&sample);
            let number = checked.unwrap_or(u64::MAX);
            let sent = lock(&shared.sent).get(&number).copied();
            lock(&ours).push(Seen {
                at,
                age_ns: sent.map_or(0, |it| u64::try_from(at.since(it).as_nanos()).unwrap_or(0)),
                number,
                damaged: checked.is_err() || sent.is_none(),
            });
        }
        Ok(())
    };
    Ok((log, start(subscribe)?))
}

fn start(
    work: impl FnOnce() -> Result<(), DemoError> + Send + 'static,
) -> Result<JoinHandle<Result<(), DemoError>>, DemoError> {
    let thread = thread::Builder::new().spawn(work);
    thread.map_err(DemoError::system("start a thread"))
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
