//! Recording topics of a domain.

mod parts;
mod topic;
mod writing;

use std::collections::BTreeSet;
use std::os::fd::BorrowedFd;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use sm2_node::domain::{Contract, Watch};
use sm2_node::wait_set::{Interest, Waitable};
use sm2_node::{Node, RecvError, Timer, WaitSet};
use sm2_proto::Name;

pub use self::parts::Split;
use self::parts::{Output, Parts};
use self::topic::Topic;
use self::writing::write;
use crate::clock::ClockRelation;
use crate::error::{RecordError, WriteError};
use crate::folder::Folder;
use crate::queue::{HeldBy, Item, Payload, Queue, Written};
use crate::report::Report;
use crate::storage::Storage;
use crate::writer::{COPY_MAX_BYTES, Compression};

/// How many longer messages of a topic the recorder holds in the slots of their publishers.
const HELD_MAX: usize = 8;
/// How many messages of a publisher wait for the recorder.
const DEPTH: u16 = 64;
/// How many messages of a topic are taken before the other topics have their turn.
const BURST: usize = 64;
/// A smaller step of the wall clock is its normal adjustment.
const STEP_MIN: Duration = Duration::from_millis(10);

/// The options of a recording.
#[derive(Clone, Debug)]
pub struct Options {
    /// The topics.
    pub topics: Topics,
    /// The topics whose publishers wait for the recorder instead of displacing messages. Each one needs a reliable
    /// publisher.
    pub reliable: BTreeSet<Name>,
    /// How many bytes of payloads may wait for the disk; 256 MiB by default. Messages beyond that are dropped, and
    /// become a [gap](crate::GapReason::Budget).
    pub budget_bytes: u64,
    /// How often the recording is made safe against a power cut; every 100 ms by default.
    pub sync_interval: Duration,
    /// How chunks are compressed; not at all by default.
    pub compression: Compression,
    /// How many bytes of the disk stay free: the recording ends before; 1 GiB by default. More than
    /// [`budget_bytes`](Self::budget_bytes), because messages that wait are still written.
    pub min_free_bytes: u64,
}

/// The topics to record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Topics {
    /// All topics that have a publisher, also those that come later.
    All,
    /// These topics, whether they have a publisher or not.
    Named(BTreeSet<Name>),
}

impl Options {
    /// The defaults for these topics.
    #[must_use]
    pub const fn new(topics: Topics) -> Self {
        Self {
            topics,
            reliable: BTreeSet::new(),
            budget_bytes: 256 << 20,
            sync_interval: Duration::from_millis(100),
            compression: Compression::None,
            min_free_bytes: 1 << 30,
        }
    }
}

/// How far a recording is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// The number of topics with a subscriber.
    pub topics: usize,
    /// The number of messages in the file.
    pub messages: u64,
    /// The length of their payloads, in bytes.
    pub bytes: u64,
    /// The number of messages that are missing in the file.
    pub lost: u64,
    /// The length of the payloads that wait for the disk, in bytes.
    pub waiting_bytes: u64,
}

/// Why [`Recorder::step`] has returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The time is over.
    Timeout,
    /// The descriptor `stop` is readable.
    Stopped,
    /// The domain may have changed, or a [further source](Recorder::wake_on) may have something.
    Woken,
    /// The disk is full up to the [reserve](Options::min_free_bytes). Nothing more is taken;
    /// [`finish`](Recorder::finish) completes the bag.
    DiskFull,
}

/// Records topics of a domain.
///
/// A recorder is an ordinary keep-last subscriber of each topic: no publisher waits for it or for the disk, except for
/// the [reliable](Options::reliable) topics. A thread of its own writes the file. If the disk is slower than the
/// publishers, up to [`budget_bytes`](Options::budget_bytes) wait in memory, then messages are dropped and counted.
pub struct Recorder<'fd> {
    node: Node,
    options: Options,
    set: WaitSet<'fd, Event>,
    watch: Watch,
    topics: Vec<Topic>,
    /// The topics that are recorded, and those that the Manager does not let this node subscribe to.
    known: BTreeSet<Name>,
    clock: ClockRelation,
    /// The last relation of the clocks that is in the bag.
    last_clock: ClockRelation,
    queue: Arc<Queue>,
    writer: Option<JoinHandle<Option<Report>>>,
    lost: u64,
}

#[derive(Clone, Copy, Debug)]
enum Event {
    /// A topic may have a message.
    Topic(usize),
    /// The domain may have changed.
    Domain,
    /// The caller's descriptor is ready.
    Stop,
    /// The clocks are compared.
    Clock,
    /// The writer has room for reliable topics again.
    Room,
    /// A source of the caller is ready.
    Other,
}

impl<'fd> Recorder<'fd> {
    /// Starts to record into `storage`, which is empty. The descriptor `stop` ends [`step`](Self::step) when it is
    /// readable.
    ///
    /// # Errors
    ///
    /// See [`RecordError`].
    pub fn start(
        node: &Node,
        storage: impl Storage + 'static,
        options: Options,
        stop: BorrowedFd<'fd>,
    ) -> Result<Self, RecordError> {
        Self::start_to(node, Output::File(Box::new(storage)), options, stop)
    }

    /// Starts to record into the files of a folder. Otherwise as [`start`](Self::start).
    ///
    /// # Errors
    ///
    /// See [`RecordError`].
    pub fn start_in(
        node: &Node,
        folder: Folder,
        split: Split,
        options: Options,
        stop: BorrowedFd<'fd>,
    ) -> Result<Self, RecordError> {
        Self::start_to(node, Output::Folder(folder, split), options, stop)
    }

    fn start_to(
        node: &Node,
        output: Output,
        options: Options,
        stop: BorrowedFd<'fd>,
    ) -> Result<Self, RecordError> {
        let clock = ClockRelation::now();
        let parts = Parts::new(output, options.compression, options.min_free_bytes, clock);
        let parts = parts.map_err(RecordError::Write)?;
        let mut set = WaitSet::new().map_err(RecordError::System)?;
        set.add_descriptor(stop, Interest::Readable, Event::Stop)
            .and_then(|_| set.add_descriptor(node.clone(), Interest::Readable, Event::Domain))
            .map_err(RecordError::System)?;
        set.add_timer(Timer::every(options.sync_interval), Event::Clock);
        let queue = Arc::new(Queue::new().map_err(RecordError::System)?);
        set.add_descriptor(Arc::clone(queue.room()), Interest::Readable, Event::Room)
            .map_err(RecordError::System)?;
        let (theirs, interval) = (Arc::clone(&queue), options.sync_interval);
        let writer = sm2_io::spawn_without_signals("sm2-bag".to_owned(), move || {
            match write(parts, &theirs, interval, clock) {
                Ok(report) => Some(report),
                Err(error) => {
                    theirs.fail(error);
                    None
                }
            }
        });
        let mut recorder = Self {
            node: node.clone(),
            set,
            watch: node.watch(),
            topics: Vec::new(),
            known: BTreeSet::new(),
            clock,
            last_clock: clock,
            queue,
            writer: Some(writer.map_err(RecordError::System)?),
            lost: 0,
            options,
        };
        if let Topics::Named(names) = recorder.options.topics.clone() {
            for name in names {
                recorder.subscribe(&name)?;
            }
        }
        recorder.look_at_domain()?;
        Ok(recorder)
    }

    /// Records for at most `timeout`, or until something else happens: see [`Step`].
    ///
    /// # Errors
    ///
    /// See [`RecordError`]. After an error, [`finish`](Self::finish) ends the file as well as it can.
    pub fn step(&mut self, timeout: Duration) -> Result<Step, RecordError> {
        let until = sm2_io::clock::now().after(timeout);
        loop {
            if self.queue.has_failed() {
                let error = self.queue.take_error().unwrap_or(WriteError::Panicked);
                return Err(RecordError::Write(error));
            }
            if self.queue.is_disk_full() {
                return Ok(Step::DiskFull);
            }
            let left = until.since(sm2_io::clock::now());
            let Some(ready) = self.set.wait_timeout(left)? else {
                return Ok(Step::Timeout);
            };
            match ready.tag {
                Event::Topic(topic) => self.take(topic, BURST)?,
                Event::Domain => {
                    self.look_at_domain()?;
                    return Ok(Step::Woken);
                }
                Event::Stop => return Ok(Step::Stopped),
                Event::Clock => self.compare_clocks(),
                Event::Room => self.resume()?,
                Event::Other => return Ok(Step::Woken),
            }
        }
    }

    /// Lets [`step`](Self::step) return when `source` may have something.
    ///
    /// # Errors
    ///
    /// Any error of the operating system.
    pub fn wake_on(&mut self, source: &impl Waitable) -> std::io::Result<()> {
        self.set.add(source, Event::Other).map(|_| ())
    }

    /// As [`wake_on`](Self::wake_on), for a descriptor that becomes readable.
    ///
    /// # Errors
    ///
    /// Any error of the operating system.
    pub fn wake_on_descriptor(&mut self, descriptor: BorrowedFd<'fd>) -> std::io::Result<()> {
        let added = self
            .set
            .add_descriptor(descriptor, Interest::Readable, Event::Other);
        added.map(|_| ())
    }

    /// The time of the wall clock as it was at the start of the recording, in nanoseconds since 1970 (UTC).
    pub(crate) fn now_ns(&self) -> u64 {
        self.clock.wall_at(sm2_io::clock::now())
    }

    /// Whether a node is in the domain.
    pub(crate) fn has_node(&self, name: &Name) -> bool {
        self.watch.domain().node_named(name.as_str()).is_some()
    }

    /// Lets the next message begin a new file of the folder. The file before it has everything up to now.
    pub(crate) fn end_file(&self) {
        self.queue.push(Item::EndFile(self.now_ns()));
    }

    /// How far the recording is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        let Written { messages, bytes } = self.queue.written();
        Progress {
            topics: self.topics.len(),
            messages,
            bytes,
            lost: self.lost,
            waiting_bytes: self.queue.waiting_bytes(),
        }
    }

    /// Takes the messages that have already come, writes the summary, and ends the file.
    ///
    /// # Errors
    ///
    /// [`RecordError::Write`]. Everything before the last interval can be read even then.
    pub fn finish(mut self) -> Result<Report, RecordError> {
        let mut taken = Ok(());
        for topic in 0..self.topics.len() {
            // As many as can have waited when the recording ended: the publishers do not stop.
            let publishers = self.topics[topic].publishers().max(1);
            taken = taken.and(self.take(topic, usize::from(DEPTH) * publishers));
        }
        self.queue.close();
        let report = self.writer.take().and_then(|it| it.join().ok().flatten());
        match (report, self.queue.take_error()) {
            (_, Some(error)) => Err(RecordError::Write(error)),
            (None, None) => Err(RecordError::Write(WriteError::Panicked)),
            (Some(report), None) => taken.map(|()| report),
        }
    }

    /// Subscribes to the topics that have come.
    fn look_at_domain(&mut self) -> Result<(), RecordError> {
        self.node.spin_some().map_err(RecordError::System)?;
        // The call that finds no change asks the Manager for the next one.
        while !self.watch.try_wait()?.is_empty() {}
        if self.options.topics != Topics::All {
            return Ok(());
        }
        let interfaces = self.watch.domain().interfaces();
        let topics: BTreeSet<_> = interfaces
            .filter(|it| matches!(it.contract, Contract::Publisher { .. }))
            .map(|it| it.contract.name().clone())
            .collect();
        for topic in &topics {
            if self.known.contains(topic) {
                continue;
            }
            match self.subscribe(topic) {
                // The access policy may deny this topic. The others are recorded.
                Err(RecordError::Declare(error)) => {
                    tracing::error!(%topic, %error, "the topic is not recorded");
                    self.known.insert(topic.clone());
                }
                result => result?,
            }
        }
        Ok(())
    }

    fn subscribe(&mut self, name: &Name) -> Result<(), RecordError> {
        let builder = self.node.subscriber_builder::<[u8]>(name.as_str());
        let subscriber = builder
            .any_type()
            .depth(DEPTH)
            // One more than are held, so that the next message can always be taken.
            .max_borrowed(HELD_MAX as u16 + 1)
            .reliable(self.options.reliable.contains(name))
            .declare()?;
        let number = self.topics.len();
        let added = self.set.add(&subscriber, Event::Topic(number));
        let key = added.map_err(RecordError::System)?;
        self.known.insert(name.clone());
        let is_reliable = self.options.reliable.contains(name);
        self.topics.push(Topic::new(subscriber, key, is_reliable));
        Ok(())
    }

    /// Takes messages of the reliable topics again that waited for room.
    fn resume(&mut self) -> Result<(), RecordError> {
        self.queue.take_room_signal().map_err(RecordError::System)?;
        for (number, topic) in self.topics.iter_mut().enumerate() {
            if topic.key.is_none() {
                let added = self.set.add(&topic.subscriber, Event::Topic(number));
                topic.key = Some(added.map_err(RecordError::System)?);
            }
        }
        Ok(())
    }

    /// Takes up to `most` messages of a topic.
    fn take(&mut self, number: usize, most: usize) -> Result<(), RecordError> {
        let budget = self.options.budget_bytes;
        let held_by = HeldBy(number);
        for _ in 0..most {
            let topic = &mut self.topics[number];
            if topic.is_reliable && !self.queue.has_room(budget, held_by, HELD_MAX) {
                // Its messages stay with their publishers, which wait.
                if let Some(key) = topic.key.take() {
                    self.set.remove(key);
                }
                return Ok(());
            }
            let sample = match topic.subscriber.try_recv() {
                Ok(Some(sample)) => sample,
                Ok(None) => return Ok(()),
                // The writer gives back soon.
                Err(RecvError::TooManyBorrowed { .. }) => return Ok(()),
                // The other publishers are recorded further on.
                Err(error @ RecvError::Map { .. }) => {
                    tracing::error!(topic = %topic.subscriber.topic(), %error, "a message is not recorded");
                    return Ok(());
                }
                Err(error) => return Err(error.into()),
            };
            let now = self.clock.wall_at(sm2_io::clock::now());
            let Some(mut taken) = topic.note(&self.node, &sample, &self.clock, now) else {
                continue;
            };
            if let Some(gap) = taken.displaced.take() {
                self.lost += gap.messages;
                self.queue.push(Item::Gap(Arc::clone(&taken.source), gap));
            }
            let len = sample.len();
            let has_room = topic.is_reliable || self.queue.waiting_bytes() + len as u64 <= budget;
            let payload = if !has_room {
                None
            } else if len <= COPY_MAX_BYTES {
                Some(Payload::Copied(sample.to_vec()))
            } else if self.queue.held(held_by) < HELD_MAX {
                Some(Payload::Held(sample, held_by))
            } else {
                None
            };
            match payload {
                Some(payload) => {
                    topic.note_recorded(&taken);
                    self.queue.push(Item::Message {
                        source: taken.source,
                        times: taken.times,
                        payload,
                    });
                }
                None => {
                    self.lost += 1;
                    let gap = topic.dropped(&taken);
                    self.queue.push(Item::Gap(taken.source, gap));
                }
            }
        }
        Ok(())
    }

    /// Notes a step of the wall clock.
    fn compare_clocks(&mut self) {
        let clock = ClockRelation::now();
        if self.last_clock.step_to(&clock) >= STEP_MIN {
            self.last_clock = clock;
            self.queue.push(Item::Clock(clock));
        }
    }
}
