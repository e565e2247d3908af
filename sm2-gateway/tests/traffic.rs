//! Publisher and subscriber threads, and logs of the messages that they sent and received.
#![allow(dead_code, reason = "each program uses its own part")]

use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use sm2_node::{Node, Publisher, Subscriber};

/// How often a thread checks whether it has to stop.
const LOOK: Duration = Duration::from_millis(100);
/// How many messages may wait for a local subscriber: enough for a machine that is busy for several seconds, if the
/// messages are short, for 20 seconds.
const fn depth(len_bytes: usize) -> u16 {
    if len_bytes < 100_000 { 1_024 } else { 256 }
}

/// A message that was published.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sent {
    pub(crate) at: Instant,
    /// How long `publish` took.
    pub(crate) took: Duration,
}

/// A message that was received.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub(crate) at: Instant,
    pub(crate) age: Duration,
    /// The number of the message, or `None` if any of its bytes differs from what was sent.
    pub(crate) number: Option<u64>,
}

type Log<T> = Arc<Mutex<Vec<T>>>;

/// Publishes until it is stopped.
pub(crate) struct Talker {
    len_bytes: usize,
    pub(crate) sent: Log<Sent>,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Talker {
    pub(crate) fn start(node: &Node, topic: &str, len_bytes: usize, hz: u32) -> Self {
        let publisher: Publisher<[u8]> = node
            .publisher_builder(topic)
            .depth(depth(len_bytes))
            // The half of it is for subscribers that have not taken their messages yet.
            .pool_limit(4 * u64::from(depth(len_bytes)) * len_bytes as u64)
            .declare()
            .unwrap();
        let sent: Log<Sent> = Log::default();
        let stop = Arc::new(AtomicBool::new(false));
        let (log, until) = (Arc::clone(&sent), Arc::clone(&stop));
        let thread = thread::spawn(move || {
            let mut next = Instant::now();
            for number in 0.. {
                thread::sleep(next.saturating_duration_since(Instant::now()));
                if until.load(Ordering::Relaxed) {
                    return;
                }
                let mut loan = publisher.loan_slice(len_bytes).unwrap();
                fill(number, &mut loan);
                // The message may arrive before `publish` returns.
                let at = Instant::now();
                let took = Duration::ZERO;
                log.lock().unwrap().push(Sent { at, took });
                loan.publish().unwrap();
                log.lock().unwrap()[usize::try_from(number).unwrap()].took = at.elapsed();
                next += Duration::from_secs(1) / hz;
            }
        });
        Self {
            len_bytes,
            sent,
            stop,
            thread,
        }
    }

    /// The number of messages sent.
    pub(crate) fn count(&self) -> u64 {
        self.sent.lock().unwrap().len() as u64
    }

    /// Stops the publisher. Returns the number of its messages.
    pub(crate) fn stop(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
        self.sent.lock().unwrap().len() as u64
    }
}

/// The links of a listener.
#[derive(Clone, Copy, Debug, Default)]
struct Links {
    /// How many publishers the subscriber is linked with.
    up: usize,
    /// How many links have ended.
    ended: usize,
    /// How often in a row nothing came while no link was up. Nothing is left to take then.
    idle: usize,
}

/// Receives until it is stopped.
pub(crate) struct Listener {
    pub(crate) seen: Log<Seen>,
    links: Arc<Mutex<Links>>,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Listener {
    /// Starts a listener that wants all messages.
    pub(crate) fn all(node: &Node, topic: &str, talker: &Talker) -> Self {
        Self::start(node, topic, talker, depth(talker.len_bytes))
    }

    /// Starts a listener that wants only the newest message.
    pub(crate) fn newest(node: &Node, topic: &str, talker: &Talker) -> Self {
        Self::start(node, topic, talker, 1)
    }

    fn start(node: &Node, topic: &str, talker: &Talker, depth: u16) -> Self {
        let builder = node.subscriber_builder(topic).depth(depth);
        let subscriber: Subscriber<[u8]> = builder.declare().unwrap();
        let seen: Log<Seen> = Log::default();
        let links = Arc::new(Mutex::new(Links::default()));
        let stop = Arc::new(AtomicBool::new(false));
        let sent = Arc::clone(&talker.sent);
        let (log, count, until) = (Arc::clone(&seen), Arc::clone(&links), Arc::clone(&stop));
        let thread = thread::spawn(move || {
            loop {
                let all = subscriber.links();
                let ended = all.iter().filter(|it| it.end.is_some()).count();
                let up = all.len() - ended;
                {
                    let mut links = count.lock().unwrap();
                    let idle = if up == 0 { links.idle } else { 0 };
                    *links = Links { up, ended, idle };
                }
                match subscriber.recv_timeout(LOOK).unwrap() {
                    Some(sample) => {
                        count.lock().unwrap().idle = 0;
                        log.lock().unwrap().push(judge(&sample, &sent));
                    }
                    // Messages that arrived before the stop were all taken.
                    None if until.load(Ordering::Relaxed) => return,
                    None if up == 0 => count.lock().unwrap().idle += 1,
                    None => {}
                }
            }
        });
        Self {
            seen,
            links,
            stop,
            thread,
        }
    }

    /// The number of links that are up.
    pub(crate) fn links(&self) -> usize {
        self.links.lock().unwrap().up
    }

    /// True if no link is up, and all messages of earlier links were taken: twice nothing came without a link.
    pub(crate) fn is_cut_off(&self) -> bool {
        self.links.lock().unwrap().idle >= 2
    }

    /// True if a message came that is newer than this number.
    pub(crate) fn has_newer(&self, number: u64) -> bool {
        let seen = self.seen.lock().unwrap();
        seen.iter().any(|it| it.number > Some(number))
    }

    /// The number of links that have ended.
    pub(crate) fn ended(&self) -> usize {
        self.links.lock().unwrap().ended
    }

    /// The number of messages received.
    pub(crate) fn count(&self) -> usize {
        self.seen.lock().unwrap().len()
    }

    /// Stops the listener. Returns all received messages. Stop the publisher first.
    pub(crate) fn stop(self) -> Vec<Seen> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
        std::mem::take(&mut *self.seen.lock().unwrap())
    }
}

fn judge(message: &[u8], sent: &Log<Sent>) -> Seen {
    let at = Instant::now();
    let number = check(message);
    let index = number.and_then(|it| usize::try_from(it).ok());
    let sent = index.and_then(|it| sent.lock().unwrap().get(it).copied());
    Seen {
        at,
        age: sent.map_or(Duration::ZERO, |it| at.saturating_duration_since(it.at)),
        number: number.filter(|_| sent.is_some()),
    }
}

/// No message is damaged, and each is newer than the previous one.
pub(crate) fn assert_newer(who: &str, seen: &[Seen]) {
    assert!(
        seen.iter().all(|it| it.number.is_some()),
        "{who}: a message is damaged"
    );
    let backward = seen.windows(2).find(|it| it[0].number >= it[1].number);
    assert!(
        backward.is_none(),
        "{who}: twice, or back again: {backward:?}"
    );
}

/// All `count` messages arrived, in order and undamaged.
pub(crate) fn assert_complete(who: &str, seen: &[Seen], count: u64) {
    assert_newer(who, seen);
    let lost = count - seen.len() as u64;
    assert_eq!(lost, 0, "{who}: {lost} of {count} messages are lost");
}

/// The least duration that `percent` percent of the values do not exceed.
pub(crate) fn percentile(percent: usize, of: impl Iterator<Item = Duration>) -> Duration {
    let mut all: Vec<Duration> = of.collect();
    all.sort_unstable();
    let rank = (all.len() * percent).div_ceil(100).max(1);
    all.get(rank - 1).copied().unwrap_or_default()
}

/// The words of a message. No two messages have the same word at the same index, and no two words
/// of one message are equal.
fn words(number: u64) -> impl Iterator<Item = u64> {
    let start = number.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    (0..).map(move |index: u64| start.wrapping_add(index.wrapping_mul(0xbf58_476d_1ce4_e5b9)))
}

fn fill(number: u64, message: &mut [u8]) {
    let (body, rest) = message.as_chunks_mut::<8>();
    assert!(rest.is_empty());
    body[0] = number.to_le_bytes();
    for (to, word) in body[1..].iter_mut().zip(words(number)) {
        *to = word.to_le_bytes();
    }
}

/// Returns the number of the message if every byte is as it was sent.
fn check(message: &[u8]) -> Option<u64> {
    let (body, rest) = message.as_chunks::<8>();
    let number = u64::from_le_bytes(*body.first()?);
    let words = words(number).map(u64::to_le_bytes);
    let same = body[1..].iter().zip(words).all(|(is, word)| *is == word);
    (same && rest.is_empty()).then_some(number)
}
