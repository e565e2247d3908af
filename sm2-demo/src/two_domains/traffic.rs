//! Who publishes and who receives.
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

/// The topic.
pub(crate) const TOPIC: &str = "camera";
/// How long a thread may not notice that it is over.
const LOOK: Duration = Duration::from_millis(100);

/// What all threads know.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    pub(crate) stop: AtomicBool,
    /// When each message was published.
    sent: Mutex<BTreeMap<u64, Instant>>,
}

/// A message that came.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// When.
    pub(crate) at: Instant,
    /// How long after it was published, in nanoseconds.
    pub(crate) age_ns: u64,
    /// Its number.
    pub(crate) number: u64,
    /// Whether a byte is not what was sent.
    pub(crate) damaged: bool,
}

/// What a subscriber has seen so far.
pub(crate) type Log = Arc<Mutex<Vec<Seen>>>;

/// Publishes until all is over.
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
    Ok(thread::spawn(move || {
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
    }))
}

/// Receives until all is over.
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
    let thread = thread::spawn(move || {
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
    });
    Ok((log, thread))
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
