//! Who publishes, who receives, and what they saw.

use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use sm2_node::{Node, Publisher, Subscriber};

/// How long a thread may not notice that it is over.
const LOOK: Duration = Duration::from_millis(100);
/// So many messages may wait for a local subscriber: a machine that is busy for two seconds loses none.
const DEPTH: u16 = 64;

/// A message that was published.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sent {
    pub(crate) at: Instant,
    /// How long the publisher was kept.
    pub(crate) took: Duration,
}

/// A message that came.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub(crate) at: Instant,
    pub(crate) age: Duration,
    /// Which; none if a byte of it is not what was sent.
    pub(crate) number: Option<u64>,
}

type Log<T> = Arc<Mutex<Vec<T>>>;

/// Publishes until it is stopped.
pub(crate) struct Talker {
    pub(crate) sent: Log<Sent>,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Talker {
    pub(crate) fn start(node: &Node, topic: &str, len_bytes: usize, hz: u32) -> Self {
        let publisher: Publisher<[u8]> = node
            .publisher_builder(topic)
            .depth(DEPTH)
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
                // A message may be there before `publish` is over.
                let at = Instant::now();
                let took = Duration::ZERO;
                log.lock().unwrap().push(Sent { at, took });
                loan.publish().unwrap();
                log.lock().unwrap()[usize::try_from(number).unwrap()].took = at.elapsed();
                next += Duration::from_secs(1) / hz;
            }
        });
        Self { sent, stop, thread }
    }

    /// How many there were.
    pub(crate) fn stop(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
        self.sent.lock().unwrap().len() as u64
    }
}

/// Receives until it is stopped.
pub(crate) struct Listener {
    pub(crate) seen: Log<Seen>,
    /// How many publishers it is linked with, and how many links ended.
    links: Arc<Mutex<(usize, usize)>>,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Listener {
    /// One that wants all messages.
    pub(crate) fn all(node: &Node, topic: &str, talker: &Talker) -> Self {
        Self::start(node, topic, talker, DEPTH)
    }

    /// One that wants the newest message.
    pub(crate) fn newest(node: &Node, topic: &str, talker: &Talker) -> Self {
        Self::start(node, topic, talker, 1)
    }

    fn start(node: &Node, topic: &str, talker: &Talker, depth: u16) -> Self {
        let builder = node.subscriber_builder(topic).depth(depth);
        let subscriber: Subscriber<[u8]> = builder.declare().unwrap();
        let seen: Log<Seen> = Log::default();
        let links = Arc::new(Mutex::new((0, 0)));
        let stop = Arc::new(AtomicBool::new(false));
        let sent = Arc::clone(&talker.sent);
        let (log, count, until) = (Arc::clone(&seen), Arc::clone(&links), Arc::clone(&stop));
        let thread = thread::spawn(move || {
            loop {
                let all = subscriber.links();
                let ended = all.iter().filter(|it| it.end.is_some()).count();
                *count.lock().unwrap() = (all.len() - ended, ended);
                match subscriber.recv_timeout(LOOK).unwrap() {
                    Some(sample) => log.lock().unwrap().push(judge(&sample, &sent)),
                    // What was there before the end was taken.
                    None if until.load(Ordering::Relaxed) => return,
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

    /// How many links there are.
    pub(crate) fn links(&self) -> usize {
        self.links.lock().unwrap().0
    }

    /// How many links ended.
    pub(crate) fn ended(&self) -> usize {
        self.links.lock().unwrap().1
    }

    /// How many messages came.
    pub(crate) fn count(&self) -> usize {
        self.seen.lock().unwrap().len()
    }

    /// Everything that came. Whoever publishes has to be stopped before.
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

/// Nothing is damaged, and each is newer than the one before.
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

/// All of `count` came, from the first to the last, without damage.
pub(crate) fn assert_complete(who: &str, seen: &[Seen], count: u64) {
    assert_newer(who, seen);
    let lost = count - seen.len() as u64;
    assert_eq!(lost, 0, "{who}: {lost} of {count} messages are lost");
}

/// The least that so many of a hundred do not exceed.
pub(crate) fn percentile(percent: usize, of: impl Iterator<Item = Duration>) -> Duration {
    let mut all: Vec<Duration> = of.collect();
    all.sort_unstable();
    let rank = (all.len() * percent).div_ceil(100).max(1);
    all.get(rank - 1).copied().unwrap_or_default()
}

/// No two messages have the same word at the same place, nor one message two equal words.
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

/// Which message it is, if each byte is what was sent.
fn check(message: &[u8]) -> Option<u64> {
    let (body, rest) = message.as_chunks::<8>();
    let number = u64::from_le_bytes(*body.first()?);
    let words = words(number).map(u64::to_le_bytes);
    let same = body[1..].iter().zip(words).all(|(is, word)| *is == word);
    (same && rest.is_empty()).then_some(number)
}
