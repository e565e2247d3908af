//! Topics that the recorder polls.
//!
//! A message that the recorder waits for costs both sides system calls, and the recorder a wake-up. The messages of
//! frequent topics therefore stay in the queues of their links until the next poll, which takes those of all topics
//! with the same interval. A poll costs a system call for each topic, so each topic has the longest interval that its
//! queues are long enough for.
//!
//! A poll orders the messages of its topics by their times of publication, limited to the time since the last poll. A
//! topic leaves the polls if it is silent, has more messages in a poll than the poll can take, or loses one. The
//! messages of each topic are in the file in their order; those of different topics can be up to 20 ms apart from it,
//! and readers sort by `log_time`.

use std::time::Duration;

use sm2_node::wait_set::Key;
use sm2_node::{RecvError, Sample};
use sm2_proto::Instant;

use super::topic::{Topic, Wait};

/// The times between two polls of a topic, the longest first.
const INTERVALS: [Duration; 3] = [
    Duration::from_millis(20),
    Duration::from_millis(8),
    Duration::from_millis(2),
];
/// The frequency of a topic is measured over this time.
const WINDOW: Duration = Duration::from_millis(100);
/// A topic with fewer messages in a second is not polled.
const FREQUENT: u64 = 40;
/// A poll can take this number of messages of a topic: all of them are borrowed until the poll has found all messages.
const TAKEN_MAX: u64 = 8;
/// A topic is not polled any more if no message has come for this time.
const SILENCE: Duration = Duration::from_millis(50);

/// The intervals of a recording that is made safe this often. An interval that is not the shortest one is a quarter of
/// that time at most, so that a power cut does not cost much more.
pub(super) fn intervals(sync_interval: Duration) -> impl Iterator<Item = Duration> {
    let all = INTERVALS.iter().copied().enumerate();
    let is_short = move |(number, it): &(usize, Duration)| {
        *it <= sync_interval / 4 || *number == INTERVALS.len() - 1
    };
    all.filter(is_short).map(|(_, it)| it)
}

/// The topics that are polled with one interval, and the messages of one poll.
pub(super) struct Polled {
    pub(super) interval: Duration,
    /// The timer of the polls, while there is a topic.
    pub(super) timer: Option<Key>,
    /// The numbers of the topics.
    topics: Vec<usize>,
    /// The time of the last poll.
    last: Instant,
    /// The messages of a topic, and of all topics; empty between polls.
    samples: Vec<Sample<[u8]>>,
    found: Vec<Found>,
}

/// A message that was found.
pub(super) struct Found {
    /// When it came, as far as the recorder knows: at the publisher's time, if that is between the last poll and this
    /// one.
    pub(super) at: Instant,
    /// The number of its topic.
    pub(super) topic: usize,
    pub(super) sample: Sample<[u8]>,
}

impl Polled {
    pub(super) const fn new(interval: Duration) -> Self {
        Self {
            interval,
            timer: None,
            topics: Vec::new(),
            last: Instant(0),
            samples: Vec::new(),
            found: Vec::new(),
        }
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.topics.is_empty()
    }

    /// Adds a topic of this frequency at `now`, if the interval is short enough for it. Returns whether the caller no
    /// longer waits for it.
    pub(super) fn add(
        &mut self,
        number: usize,
        topic: &mut Topic,
        frequency: Frequency,
        now: Instant,
    ) -> bool {
        // Publishers are not regular: there is room for four times the messages of the mean interval.
        let room = u64::from(topic.shortest_queue()).min(TAKEN_MAX);
        if frequency.in_time(self.interval * 4) > room {
            return false;
        }
        topic.polling.most = room;
        topic.polling.taken_at = now;
        topic.polling.from = now;
        if self.topics.is_empty() {
            self.last = now;
        }
        self.topics.push(number);
        topic.wait = Wait::Poll;
        true
    }

    /// Takes the messages of all polled topics at `now`, at most `most` of each: [`take_found`](Self::take_found)
    /// returns them, also those before an error. Returns the topics that are not polled any more.
    ///
    /// # Errors
    ///
    /// As those of [`Subscriber::try_recv_many`](sm2_node::Subscriber::try_recv_many), if nothing more can be received.
    pub(super) fn poll(
        &mut self,
        topics: &mut [Topic],
        most: usize,
        now: Instant,
    ) -> Result<Vec<usize>, RecvError> {
        let last = std::mem::replace(&mut self.last, now);
        let mut ended = Vec::new();
        for &number in &self.topics {
            let topic = &mut topics[number];
            let taken = topic.take(&mut self.samples, most);
            let polling = &mut topic.polling;
            let mut at = last.max(polling.from);
            self.found.extend(self.samples.drain(..).map(|sample| {
                polling.has_lost |= sample.lost() > 0;
                // The messages of a topic stay in their order, also those of a publisher with a wrong time.
                at = sample.source_time().clamp(at, now);
                Found {
                    at,
                    topic: number,
                    sample,
                }
            }));
            let count = taken?;
            if count > 0 {
                polling.taken_at = now;
            }
            let is_silent = now.since(polling.taken_at) > SILENCE;
            if is_silent || polling.has_lost || count as u64 > polling.most {
                (polling.since, polling.messages) = (now, 0);
                ended.push(number);
            }
        }
        self.topics.retain(|number| !ended.contains(number));
        Ok(ended)
    }

    /// The messages of the last poll, in the order in which they came.
    pub(super) fn take_found(&mut self) -> Vec<Found> {
        self.found.sort_by_key(|it| it.at);
        std::mem::take(&mut self.found)
    }

    /// Takes the list back, which is empty, to use its memory again.
    pub(super) fn keep(&mut self, found: Vec<Found>) {
        self.found = found;
    }
}

/// How many messages a topic had in a time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frequency {
    messages: u64,
    span: Duration,
}

impl Frequency {
    /// The frequency of a topic that had `count` messages at `now`. `None` if it is not known yet, or if the topic is
    /// never polled.
    pub(super) fn of(topic: &mut Topic, count: usize, now: Instant) -> Option<Self> {
        let measured = &mut topic.polling;
        measured.messages += count as u64;
        let span = now.since(measured.since);
        if span < WINDOW {
            return None;
        }
        let messages = std::mem::take(&mut measured.messages);
        measured.since = now;
        let frequency = Self { messages, span };
        // The publishers of a reliable topic wait for the recorder.
        let is_polled = !topic.is_reliable
            && !topic.polling.has_lost
            && frequency.in_time(Duration::from_secs(1)) >= FREQUENT;
        is_polled.then_some(frequency)
    }

    /// The number of messages in a time of this length.
    fn in_time(self, time: Duration) -> u64 {
        let messages = u128::from(self.messages) * time.as_nanos() / self.span.as_nanos();
        messages.try_into().unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use sm2_node::{Node, Publisher, WaitSet};

    use super::*;

    const SHORTEST: Duration = INTERVALS[INTERVALS.len() - 1];

    /// A domain with a topic for each of two publishers, which the recorder polls.
    struct Fixture {
        _manager: sm2_manager::Background,
        _folder: tempfile::TempDir,
        publishers: Vec<Publisher<[u8]>>,
        topics: Vec<Topic>,
        polled: Polled,
    }

    impl Fixture {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            let socket = folder.path().join("sock");
            let manager = sm2_manager::Background::start(&socket, Default::default()).unwrap();
            let node = |name| Node::builder(name).socket(&socket).connect().unwrap();
            let (talker, recorder) = (node("talker"), node("recorder"));
            let mut set = WaitSet::new().unwrap();
            let mut it = Self {
                _manager: manager,
                _folder: folder,
                publishers: Vec::new(),
                topics: Vec::new(),
                polled: Polled::new(SHORTEST),
            };
            for (number, name) in ["left", "right"].into_iter().enumerate() {
                let publisher = talker.publisher_builder::<[u8]>(name).depth(64);
                let publisher = publisher.declare().unwrap();
                let subscriber = recorder.subscriber_builder::<[u8]>(name).depth(64);
                let subscriber = subscriber.max_borrowed(TAKEN_MAX as u16 + 1).declare();
                let subscriber = subscriber.unwrap();
                while !publisher.links().iter().any(|it| it.open) {
                    std::thread::yield_now();
                }
                let key = set.add(&subscriber, ()).unwrap();
                it.publishers.push(publisher);
                it.topics.push(Topic::new(subscriber, key, false, 0));
                assert!(it.add(number, 10, WINDOW));
            }
            it
        }

        /// Adds a topic that had so many messages in this time.
        fn add(&mut self, number: usize, count: usize, span: Duration) -> bool {
            let now = sm2_io::clock::now();
            let topic = &mut self.topics[number];
            topic.polling.since = Instant(now.0 - span.as_nanos() as u64);
            let frequency = Frequency::of(topic, count, now);
            frequency.is_some_and(|it| self.polled.add(number, topic, it, now))
        }

        /// The topics and first bytes of the messages of a poll, in their order, and the topics that are no longer
        /// polled.
        fn poll(&mut self) -> (Vec<(usize, u8)>, Vec<usize>) {
            let last = self.polled.last;
            // A busy machine makes no topic silent.
            for topic in &mut self.topics {
                if topic.polling.taken_at != Instant(0) {
                    topic.polling.taken_at = sm2_io::clock::now();
                }
            }
            let now = sm2_io::clock::now();
            let ended = self.polled.poll(&mut self.topics, 64, now).unwrap();
            let found = self.polled.take_found();
            let times: Vec<_> = found.iter().map(|it| it.at).collect();
            assert!(
                times
                    .iter()
                    .all(|it| (last..=self.polled.last).contains(it))
            );
            assert!(times.is_sorted());
            let messages = found.iter().map(|it| (it.topic, it.sample[0])).collect();
            (messages, ended)
        }
    }

    #[test]
    fn messages_of_all_topics_are_in_the_order_of_their_publication() {
        let mut it = Fixture::new();
        for number in 0..16_u8 {
            it.publishers[usize::from(number % 2)]
                .publish(&[number])
                .unwrap();
        }
        let expected = (0..16).map(|number| (usize::from(number % 2), number));
        assert_eq!(it.poll().0, expected.collect::<Vec<_>>());
    }

    /// Readers sort the messages by their times.
    #[test]
    fn a_message_is_not_before_one_that_was_taken_earlier() {
        let mut it = Fixture::new();
        it.polled.topics.retain(|topic| *topic != 0);
        it.publishers[0].publish(&[1]).unwrap();
        it.publishers[0].publish(&[2]).unwrap();
        let mut samples = Vec::new();
        assert_eq!(it.topics[0].take(&mut samples, 1).unwrap(), 1);
        let taken_at = sm2_io::clock::now();
        assert!(it.add(0, 10, WINDOW));
        let now = sm2_io::clock::now();
        it.polled.poll(&mut it.topics, 64, now).unwrap();
        let found = it.polled.take_found();
        assert!(found.len() == 1 && found[0].at >= taken_at);
    }

    #[test]
    fn a_topic_that_is_silent_or_too_fast_is_not_polled_any_more() {
        let mut it = Fixture::new();
        let publish = |it: &Fixture, topic: usize, count: u8| {
            for number in 0..count {
                it.publishers[topic].publish(&[number]).unwrap();
            }
        };
        publish(&it, 0, 8);
        assert!(it.poll().1.is_empty());
        publish(&it, 0, 9);
        publish(&it, 1, 1);
        assert_eq!(it.poll().1, [0]);
        it.topics[1].polling.taken_at = Instant(0);
        assert_eq!(it.poll(), (vec![], vec![1]));
        assert!(it.polled.is_empty());
    }

    #[test]
    fn a_topic_that_loses_messages_between_polls_is_never_polled_again() {
        let mut it = Fixture::new();
        for number in 0..65 {
            it.publishers[0].publish(&[number]).unwrap();
        }
        it.topics[0].polling.most = 64;
        assert_eq!(it.poll().1, [0]);
        assert!(!it.add(0, 10, WINDOW));
    }

    #[test]
    fn a_topic_has_the_longest_interval_in_which_its_queue_fills_to_a_quarter() {
        let mut it = Fixture::new();
        for (in_a_second, expected) in [
            (112, Some(20)),
            (113, Some(8)),
            (281, Some(8)),
            (282, Some(2)),
        ] {
            let mut all = intervals(Duration::from_millis(80));
            let found = all.find(|interval| {
                it.polled = Polled::new(*interval);
                it.add(0, in_a_second, Duration::from_secs(1))
            });
            let found = found.map(|it| it.as_millis());
            assert_eq!(found, expected, "{in_a_second}");
        }
    }

    #[test]
    fn a_poll_delays_a_message_by_a_quarter_of_the_time_between_synchronizations() {
        let of = |time_ms| {
            let all = intervals(Duration::from_millis(time_ms));
            all.map(|it| it.as_millis()).collect::<Vec<_>>()
        };
        assert_eq!(of(80), [20, 8, 2]);
        assert_eq!(of(79), [8, 2]);
        assert_eq!(of(31), [2]);
        // The shortest one is always there.
        assert_eq!(of(1), [2]);
    }

    #[test]
    fn a_rare_a_reliable_or_a_fast_topic_is_not_polled() {
        let mut it = Fixture::new();
        let second = Duration::from_secs(1);
        assert!(it.add(0, 40, second));
        assert!(!it.add(0, 39, second));
        // 8 messages in four intervals.
        assert!(it.add(0, 1_000, second));
        assert!(!it.add(0, 1_200, second));
        assert!(!it.add(0, 10, WINDOW / 2));
        it.topics[0].is_reliable = true;
        assert!(!it.add(0, 40, second));
    }
}
