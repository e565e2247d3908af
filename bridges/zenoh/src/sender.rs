//! The messages that wait for the network, and the thread that puts them into it.
//!
//! Zenoh takes a message only when it has room for it, which a stalled network never has. So one thread waits for
//! Zenoh, and the bridge goes on. Meanwhile the messages wait in the [`Schedule`] of the gateways: it shares the
//! network among the topics, keeps the budgets of the rules, and drops the oldest messages of a topic first.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::mem;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant as Clock};

use sm2_node::now;
use sm2_proto::gateway::OfferId;
use sm2_proto::gateway::schedule::{DropCause, Input, Output, QueuedMessage, Schedule, SendQos};
use sm2_proto::{Instant, Machine};

/// How many bytes of payloads wait at most. Above that, the topic with the most bytes loses its oldest messages.
pub(crate) const WAITING_MAX_BYTES: u64 = 64 << 20;
/// How long the end of a bridge waits for a slow network.
const FLUSH_MAX: Duration = Duration::from_secs(2);

/// Puts a message into the network. Dropping it is the end of the message.
pub(crate) type Task = Box<dyn FnOnce() -> Outcome + Send>;

/// The end of a message that the network could take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// The network has it.
    Sent,
    /// The network has it. It is none of a topic, nor a request or a reply.
    Uncounted,
    /// Zenoh refuses it.
    Refused,
}

/// The counts of all messages that were to be sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SendCounts {
    pub(crate) sent: u64,
    pub(crate) refused: u64,
    pub(crate) superseded: u64,
    pub(crate) expired: u64,
    pub(crate) withdrawn: u64,
}

/// The thread that puts messages into the network. Dropping it ends it.
pub(crate) struct Sender(Arc<Shared>);

/// The messages of a topic. After it is dropped, those that wait are still sent.
pub(crate) struct Channel {
    shared: Arc<Shared>,
    offer: OfferId,
}

struct Shared {
    state: Mutex<State>,
    /// Notified when a message comes, when the bridge ends, and when the thread has ended.
    changed: Condvar,
    /// Called when no message of a watched channel waits any more.
    on_idle: Box<dyn Fn() + Send + Sync>,
}

struct State {
    schedule: Schedule<Task>,
    /// How many messages of each channel wait or are in flight.
    pending: BTreeMap<OfferId, u64>,
    /// The channels that are closed when no message waits any more.
    closing: BTreeSet<OfferId>,
    /// The channels whose end of waiting is reported, and whether one of them waits for nothing now.
    watched: BTreeSet<OfferId>,
    has_idle: bool,
    last_offer: u64,
    counts: SendCounts,
    /// Messages that are to be dropped without the lock: that may call Zenoh.
    dropped: Vec<Task>,
    /// The time when the thread ends, though messages may wait.
    end_at: Option<Clock>,
    has_ended: bool,
}

impl Sender {
    /// Starts the thread. It calls `on_idle` when no message of a [watched](Channel::watch) channel waits any more.
    pub(crate) fn start(on_idle: impl Fn() + Send + Sync + 'static) -> io::Result<Self> {
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                schedule: Schedule::new(WAITING_MAX_BYTES),
                pending: BTreeMap::new(),
                closing: BTreeSet::new(),
                watched: BTreeSet::new(),
                has_idle: false,
                last_offer: 0,
                counts: SendCounts::default(),
                dropped: Vec::new(),
                end_at: None,
                has_ended: false,
            }),
            changed: Condvar::new(),
            on_idle: Box::new(on_idle),
        });
        let its = Arc::clone(&shared);
        let thread = thread::Builder::new().name("sender".to_owned());
        thread.spawn(move || its.run())?;
        Ok(Self(shared))
    }

    /// A new channel, whose messages are sent in this way.
    pub(crate) fn channel(&self, qos: SendQos) -> Channel {
        let mut state = self.0.lock();
        state.last_offer += 1;
        let offer = OfferId(state.last_offer);
        state.feed(Input::Open { offer, qos });
        drop(state);
        Channel {
            shared: Arc::clone(&self.0),
            offer,
        }
    }

    /// Reads the counts, also when the sender is gone.
    pub(crate) fn counts(&self) -> impl Fn() -> SendCounts + Send + Sync + 'static {
        let shared = Arc::clone(&self.0);
        move || shared.lock().counts
    }
}

impl Drop for Sender {
    /// Sends the messages that wait, as far as the network takes them soon.
    fn drop(&mut self) {
        let mut state = self.0.lock();
        let end_at = Clock::now() + FLUSH_MAX;
        state.end_at = Some(end_at);
        self.0.changed.notify_all();
        while !state.has_ended && Clock::now() < end_at {
            let left = end_at.saturating_duration_since(Clock::now());
            state = self.0.wait(state, Some(left));
        }
        // Without `has_ended`, the thread waits for Zenoh, and ends when the session does.
    }
}

impl Channel {
    /// Sends a message of `len` bytes as soon as its turn comes.
    pub(crate) fn put(&self, len: usize, published_at: Instant, task: Task) {
        let message = QueuedMessage {
            message: task,
            len_bytes: len as u64,
            published_at,
        };
        let mut state = self.shared.lock();
        if state.has_ended {
            state.counts.withdrawn += 1;
            state.dropped.push(message.message);
            return self.shared.unlock(state);
        }
        *state.pending.entry(self.offer).or_default() += 1;
        let offer = self.offer;
        state.feed(Input::Enqueue { offer, message });
        self.shared.changed.notify_all();
        self.shared.unlock(state);
    }

    /// Reports when no message waits any more.
    pub(crate) fn watch(&self) {
        self.shared.lock().watched.insert(self.offer);
    }

    /// Whether no message waits.
    pub(crate) fn is_idle(&self) -> bool {
        !self.shared.lock().pending.contains_key(&self.offer)
    }
}

impl Drop for Channel {
    fn drop(&mut self) {
        let mut state = self.shared.lock();
        if !state.has_ended {
            state.closing.insert(self.offer);
            state.close_idle();
        }
        self.shared.unlock(state);
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Unlocks the state, and drops the messages that it does not need any more.
    fn unlock(&self, mut state: MutexGuard<'_, State>) {
        let dropped = mem::take(&mut state.dropped);
        drop(state);
        drop(dropped);
    }

    fn wait<'a>(
        &self,
        state: MutexGuard<'a, State>,
        timeout: Option<Duration>,
    ) -> MutexGuard<'a, State> {
        match timeout {
            Some(timeout) => {
                let waited = self.changed.wait_timeout(state, timeout);
                waited.unwrap_or_else(PoisonError::into_inner).0
            }
            None => (self.changed.wait(state)).unwrap_or_else(PoisonError::into_inner),
        }
    }

    fn run(&self) {
        let mut state = self.lock();
        loop {
            if mem::take(&mut state.has_idle) {
                drop(state);
                (self.on_idle)();
                state = self.lock();
                continue;
            }
            state.feed(Input::Tick);
            let is_late = state.end_at.is_some_and(|it| it <= Clock::now());
            let next = match is_late {
                true => None,
                false => state.start(),
            };
            if let Some((offer, task)) = next {
                self.unlock(state);
                let outcome = task();
                state = self.lock();
                state.finish(offer, outcome);
                continue;
            }
            if state.end_at.is_some() {
                state.withdraw();
                state.has_ended = true;
                self.changed.notify_all();
                return self.unlock(state);
            }
            if !state.dropped.is_empty() {
                self.unlock(state);
                state = self.lock();
                continue;
            }
            let deadline = state.schedule.deadline();
            state = self.wait(state, deadline.map(|it| it.since(now())));
        }
    }
}

impl State {
    /// Feeds the schedule, and takes what it drops. Returns the message that it starts.
    fn feed(&mut self, input: Input<Task>) -> Option<(OfferId, Task)> {
        if let Err(misuse) = self.schedule.handle(now(), input) {
            tracing::error!(?misuse, "the schedule refuses an input");
        }
        let mut started = None;
        while let Some(output) = self.schedule.poll() {
            match output {
                Output::Start { offer, message } => started = Some((offer, message)),
                Output::Drop {
                    offer,
                    message,
                    cause,
                } => {
                    self.dropped.push(message);
                    self.ends(offer);
                    let counts = &mut self.counts;
                    *match cause {
                        DropCause::Superseded | DropCause::Displaced => &mut counts.superseded,
                        DropCause::Expired => &mut counts.expired,
                        DropCause::Withdrawn => &mut counts.withdrawn,
                    } += 1;
                }
                // A channel is closed when none of its messages is in flight.
                Output::Reset { .. } => {}
            }
        }
        self.close_idle();
        started
    }

    /// Starts the message whose turn it is.
    fn start(&mut self) -> Option<(OfferId, Task)> {
        loop {
            let offer = self.schedule.order().next()?.offer();
            // The message may have become too old by now.
            if let Some(started) = self.feed(Input::Start { offer }) {
                return Some(started);
            }
        }
    }

    /// The message in flight has its end.
    fn finish(&mut self, offer: OfferId, outcome: Outcome) {
        self.feed(Input::Sent { offer });
        match outcome {
            Outcome::Sent => self.counts.sent += 1,
            Outcome::Uncounted => {}
            Outcome::Refused => self.counts.refused += 1,
        }
        self.ends(offer);
        self.close_idle();
    }

    /// A message of the channel neither waits nor is in flight any more.
    fn ends(&mut self, offer: OfferId) {
        if let Some(pending) = self.pending.get_mut(&offer) {
            *pending -= 1;
            if *pending == 0 {
                self.pending.remove(&offer);
                self.has_idle |= self.watched.contains(&offer);
            }
        }
    }

    /// Closes the channels that are gone, and have no messages.
    fn close_idle(&mut self) {
        let idle = |it: &&OfferId| !self.pending.contains_key(it);
        if let Some(offer) = self.closing.iter().find(idle).copied() {
            self.closing.remove(&offer);
            self.watched.remove(&offer);
            self.feed(Input::Close { offer });
        }
    }

    /// Drops all messages that wait.
    fn withdraw(&mut self) {
        let pending: Vec<_> = self.pending.keys().copied().collect();
        for offer in pending {
            self.feed(Input::Close { offer });
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, channel};

    use sm2_gateway::hub::DEFAULT_SEND_QOS;
    use sm2_test_support::{SOON, until};

    use super::*;

    const SHORT: usize = 1;

    /// A channel whose messages say their numbers when they are sent.
    struct Numbers {
        channel: Channel,
        sent: std::sync::mpsc::Sender<u32>,
    }

    impl Numbers {
        fn put(&self, number: u32, len: usize) {
            let sent = self.sent.clone();
            let task = move || {
                sent.send(number).unwrap();
                Outcome::Sent
            };
            self.channel.put(len, now(), Box::new(task));
        }
    }

    fn sender() -> Sender {
        Sender::start(|| {}).unwrap()
    }

    fn numbers(sender: &Sender, depth: u16) -> (Numbers, Receiver<u32>) {
        let (sent, received) = channel();
        let qos = SendQos {
            depth,
            ..DEFAULT_SEND_QOS
        };
        let channel = sender.channel(qos);
        (Numbers { channel, sent }, received)
    }

    /// A network that takes nothing until the result is dropped.
    fn stall(sender: &Sender) -> std::sync::mpsc::Sender<()> {
        let (go_on, stalled) = channel::<()>();
        let (started, has_started) = channel();
        let channel = sender.channel(DEFAULT_SEND_QOS);
        let task = move || {
            started.send(()).unwrap();
            let _ = stalled.recv_timeout(SOON);
            Outcome::Uncounted
        };
        channel.put(SHORT, now(), Box::new(task));
        has_started.recv_timeout(SOON).unwrap();
        go_on
    }

    #[test]
    fn the_newest_messages_of_each_topic_wait_for_a_stalled_network() {
        let sender = sender();
        let counts = sender.counts();
        let (busy, busy_sent) = numbers(&sender, 3);
        let (quiet, quiet_sent) = numbers(&sender, 3);
        let stalled = stall(&sender);
        quiet.put(0, SHORT);
        for number in 0..100 {
            busy.put(number, SHORT);
        }
        assert_eq!(counts().superseded, 97);
        drop(stalled);
        let sent = [(); 3].map(|()| busy_sent.recv_timeout(SOON).unwrap());
        assert_eq!(sent, [97, 98, 99]);
        assert_eq!(quiet_sent.recv_timeout(SOON), Ok(0));
        until("all are counted", || counts().sent == 4);
        assert!(busy.channel.is_idle());
    }

    #[test]
    fn long_messages_that_wait_fit_into_the_memory() {
        let sender = sender();
        let counts = sender.counts();
        let (topic, sent) = numbers(&sender, 1_000);
        let stalled = stall(&sender);
        let len = usize::try_from(WAITING_MAX_BYTES / 4).unwrap();
        for number in 0..8 {
            topic.put(number, len);
        }
        // The message in flight has one byte.
        assert_eq!(counts().superseded, 5);
        drop(stalled);
        let sent = [(); 3].map(|()| sent.recv_timeout(SOON).unwrap());
        assert_eq!(sent, [5, 6, 7]);
    }

    #[test]
    fn a_channel_that_is_gone_sends_what_waits_and_the_end_withdraws_the_rest() {
        let sender = sender();
        let counts = sender.counts();
        let (gone, sent) = numbers(&sender, 10);
        let stalled = stall(&sender);
        gone.put(1, SHORT);
        drop(gone);
        drop(stalled);
        assert_eq!(sent.recv_timeout(SOON), Ok(1));
        // The second message would be sent in an hour.
        let hourly = SendQos {
            bytes_per_s: std::num::NonZeroU64::new(1),
            ..DEFAULT_SEND_QOS
        };
        let (sent_hourly, hourly_sent) = channel();
        let hourly = Numbers {
            channel: sender.channel(hourly),
            sent: sent_hourly,
        };
        hourly.put(1, 3_600);
        assert_eq!(hourly_sent.recv_timeout(SOON), Ok(1));
        hourly.put(2, SHORT);
        drop(sender);
        assert_eq!((counts().sent, counts().withdrawn), (2, 1));
        hourly.put(3, SHORT);
        assert_eq!((counts().sent, counts().withdrawn), (2, 2));
        assert!(hourly_sent.try_recv().is_err());
    }

    #[test]
    fn messages_that_are_too_old_are_dropped() {
        let sender = sender();
        let counts = sender.counts();
        let qos = SendQos {
            max_age: Some(Duration::ZERO),
            ..DEFAULT_SEND_QOS
        };
        let channel = sender.channel(qos);
        let stalled = stall(&sender);
        channel.put(SHORT, now(), Box::new(|| Outcome::Sent));
        until("it is too old", || counts().expired == 1);
        assert!(channel.is_idle());
        drop(stalled);
    }
}
