//! Recording topics of a domain.

#[cfg(test)]
mod accounts;
mod fates;
mod losses;
mod new_topics;
mod options;
mod parts;
mod polled;
mod polling;
mod publisher;
mod receiving;
mod room;
mod subscribing;
mod topic;
mod writing;

use std::fs::File;
use std::io;
use std::os::fd::BorrowedFd;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use sm2_io::is_shortage;
use sm2_node::domain::{QueryError, Watch};
use sm2_node::wait_set::{Interest, Waitable};
use sm2_node::{ConnectError, Node, Sample, Timer, WaitSet};
use sm2_proto::{Instant, Name};

use self::new_topics::NewTopics;
pub use self::options::{Options, Progress, Step, Topics};
pub use self::parts::Split;
use self::parts::{Output, Parts};
use self::polled::{Polled, intervals};
use self::topic::{Topic, Wait};
use self::writing::write;
use crate::clock::ClockRelation;
use crate::error::{RecordError, WriteError};
use crate::folder::Folder;
use crate::queue::{Item, Queue, Written};
use crate::report::Report;
use crate::storage::Storage;

/// How many longer messages of a topic the recorder holds in the slots of their publishers.
const HELD_MAX: usize = 8;
/// How many messages of a publisher wait for the recorder.
const DEPTH: u16 = 64;
/// How many messages of a topic are taken before the other topics have their turn.
const BURST: usize = 64;
/// After so many events, a new topic has its turn even if there are more of them.
const EVENTS: usize = 64;
/// When the domain has changed, publishers that have left are looked for this often, because links end a little later.
const LOOKS: u32 = 10;
/// A smaller step of the wall clock is its normal adjustment.
const STEP_MIN: Duration = Duration::from_millis(10);

/// Connects a further session.
type Connect<'fd> = dyn FnMut() -> Result<Node, ConnectError> + Send + 'fd;

/// Records topics of a domain.
///
/// A recorder is an ordinary keep-last subscriber of each topic: no publisher waits for it or for the disk, except for
/// the [reliable](Options::reliable) topics. A thread of its own writes the file. If the disk is slower than the
/// publishers, up to [`budget_bytes`](Options::budget_bytes) wait in memory, then messages are dropped and counted.
pub struct Recorder<'fd> {
    /// The node of new topics, and those of the topics before.
    node: Node,
    nodes: Vec<Node>,
    /// The number of topics of `node`.
    in_session: usize,
    connect: Option<Box<Connect<'fd>>>,
    options: Options,
    set: WaitSet<'fd, Event>,
    watch: Watch,
    topics: Vec<Topic>,
    /// The topics that are polled, by the interval.
    polled: Vec<Polled>,
    /// The messages of one call; empty between calls.
    samples: Vec<Sample<[u8]>>,
    new_topics: NewTopics,
    /// Whether a topic is not waited for, because the operating system was short of something.
    is_short: bool,
    clock: ClockRelation,
    /// The last relation of the clocks that is in the bag.
    last_clock: ClockRelation,
    queue: Arc<Queue>,
    writer: Option<JoinHandle<Option<Report>>>,
    lost: u64,
    /// How many of the lost messages are too long.
    too_long: u64,
    /// Whether a topic may have gaps that the writer does not know.
    has_gaps: bool,
    /// When losses are looked for that no later message shows.
    look_at: Instant,
    /// When the Manager may be asked for the counters of nodes.
    ask_at: Instant,
    /// How often publishers that have left are still looked for.
    looks_left: u32,
}

#[derive(Clone, Copy, Debug)]
enum Event {
    /// A topic may have a message.
    Topic(usize),
    /// Frequent topics are polled: those with the interval of this number.
    Poll(usize),
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
        let clock = ClockRelation::read(options.wall_clock, options.monotonic_clock);
        let queue = Arc::new(Queue::new(options.budget_bytes).map_err(RecordError::System)?);
        let parts = Parts::new(output, &options, clock, node.name(), Arc::clone(&queue));
        let parts = parts.map_err(RecordError::Write)?;
        let mut set = WaitSet::new().map_err(RecordError::System)?;
        let mut watch = node.watch();
        set.add_descriptor(stop, Interest::Readable, Event::Stop)
            .and_then(|_| set.add_watch(&mut watch, Event::Domain))
            .map_err(RecordError::System)?;
        set.add_timer(Timer::every(options.sync_interval), Event::Clock);
        set.add_descriptor(Arc::clone(queue.room()), Interest::Readable, Event::Room)
            .map_err(RecordError::System)?;
        let (theirs, interval) = (Arc::clone(&queue), options.sync_interval);
        let monotonic_clock = options.monotonic_clock;
        let writer = sm2_io::spawn_without_signals("sm2-bag".to_owned(), move || {
            match write(parts, &theirs, interval, (clock, monotonic_clock)) {
                Ok(report) => Some(report),
                Err(error) => {
                    theirs.fail(error);
                    None
                }
            }
        });
        let mut recorder = Self {
            node: node.clone(),
            nodes: Vec::new(),
            in_session: 0,
            connect: None,
            set,
            watch,
            topics: Vec::new(),
            polled: intervals(options.sync_interval).map(Polled::new).collect(),
            samples: Vec::new(),
            // The files are open.
            new_topics: NewTopics::new(&options.topics),
            is_short: false,
            clock,
            last_clock: clock,
            queue,
            writer: Some(writer.map_err(RecordError::System)?),
            lost: 0,
            too_long: 0,
            has_gaps: false,
            look_at: sm2_io::clock::now(),
            ask_at: sm2_io::clock::now(),
            looks_left: 0,
            options,
        };
        let named: Vec<_> = recorder.options.topics.named().collect();
        for name in named {
            recorder.subscribe(&name)?;
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
        let mut events = 0;
        loop {
            if self.queue.has_failed() {
                let error = self.queue.take_error().unwrap_or(WriteError::Panicked);
                return Err(RecordError::Write(error));
            }
            if self.queue.ends_by_full_disk() {
                return Ok(Step::DiskFull);
            }
            // The messages of the topics that are recorded come before new topics.
            let has_new = self.new_topics.has_next();
            let left = match has_new {
                true => Duration::ZERO,
                false => until.since(sm2_io::clock::now()),
            };
            let ready = self.set.wait_timeout(left)?;
            events += 1;
            if has_new && (ready.is_none() || events % EVENTS == 0) {
                self.subscribe_next()?;
            }
            let Some(ready) = ready else {
                if has_new && sm2_io::clock::now() < until {
                    continue;
                }
                return Ok(Step::Timeout);
            };
            match ready.tag {
                Event::Topic(topic) => self.receive(topic)?,
                Event::Poll(interval) => self.poll(interval)?,
                Event::Domain => {
                    self.look_at_domain()?;
                    return Ok(Step::Woken);
                }
                Event::Stop => return Ok(Step::Stopped),
                Event::Clock => {
                    self.compare_clocks();
                    self.new_topics.resume();
                    self.topics.iter_mut().for_each(Topic::look_for_link);
                    self.look_for_losses();
                    self.flush_gaps();
                    self.forget_publishers()?;
                    if std::mem::take(&mut self.is_short) {
                        self.wait_again()?;
                    }
                }
                Event::Room => {
                    self.queue.take_room_signal().map_err(RecordError::System)?;
                    self.wait_again()?;
                }
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
        self.clock.wall_at((self.options.monotonic_clock)())
    }

    /// Whether a node is in the domain.
    pub(crate) fn has_node(&self, name: &Name) -> bool {
        self.watch.domain().node_named(name.as_str()).is_some()
    }

    /// Lets a full disk cost messages, which become gaps, instead of ending the recording.
    pub(crate) fn wait_for_room(&self) {
        self.queue.wait_for_room();
    }

    /// Whether so many bytes more leave the [reserve](Options::min_free_bytes) of the disk of `file`.
    pub(crate) fn has_room(&self, file: &File, len_bytes: u64) -> io::Result<bool> {
        let free = (self.options.free_bytes)(file)?;
        Ok(free.saturating_sub(len_bytes) >= self.options.min_free_bytes)
    }

    /// Lets the next message begin a new file of the folder. The file before it has everything up to now.
    pub(crate) fn end_file(&mut self) -> Result<(), RecordError> {
        self.poll_all()?;
        self.queue.push(Item::EndFile(self.now_ns()));
        Ok(())
    }

    /// How far the recording is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        let Written { messages, bytes } = self.queue.written();
        Progress {
            topics: self.topics.len(),
            not_recorded: self.new_topics.missed(),
            missing: self.new_topics.count(),
            messages,
            bytes,
            lost: self.lost,
            too_long: self.too_long,
            waiting_bytes: self.queue.waiting_bytes(),
            is_disk_full: self.queue.is_disk_full(),
        }
    }

    /// Takes the messages that have already come, writes the summary, and ends the file.
    ///
    /// # Errors
    ///
    /// [`RecordError::Write`]. Everything before the last interval can be read even then.
    pub fn finish(mut self) -> Result<Report, RecordError> {
        let mut taken = self.poll_all();
        for topic in 0..self.topics.len() {
            // Without room, its messages become gaps like all others: its publishers no longer wait.
            self.topics[topic].is_reliable = false;
            // As many as can have waited when the recording ended: the publishers do not stop.
            let its = &self.topics[topic];
            let queues = its.publishers() + its.subscriber.links().len();
            let mut left = usize::from(DEPTH) * queues.max(1);
            while left > 0 && taken.is_ok() {
                match self.take(topic, left) {
                    Ok(0) => break,
                    Ok(count) => left -= count,
                    Err(error) => taken = Err(error),
                }
            }
        }
        self.look_at_losses(|_| true);
        self.topics
            .iter_mut()
            .for_each(|it| it.flush_gaps(&self.queue));
        self.report_unlinked();
        match self.new_topics.unnamed() {
            0 => {}
            count => self.queue.push(Item::NotRecorded(count as u64)),
        }
        self.queue.close();
        let report = self.writer.take().and_then(|it| it.join().ok().flatten());
        match (report, self.queue.take_error()) {
            (_, Some(error)) => Err(RecordError::Write(error)),
            (None, None) => Err(RecordError::Write(WriteError::Panicked)),
            (Some(report), None) => taken.map(|()| report),
        }
    }

    /// Follows the changes of the domain.
    fn look_at_domain(&mut self) -> Result<(), RecordError> {
        loop {
            // The call that finds no change asks the Manager for the next one.
            match self.watch.try_wait() {
                Ok(none) if none.is_empty() => return Ok(()),
                Ok(_) => {
                    self.looks_left = LOOKS;
                    self.new_topics.domain_changed();
                }
                // The watch is ready again.
                Err(QueryError::Io(error)) if is_shortage(&error) => return Ok(()),
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Waits again for the messages of the topics that are not waited for.
    fn wait_again(&mut self) -> Result<(), RecordError> {
        for number in 0..self.topics.len() {
            if self.topics[number].wait == Wait::Room {
                self.wait_for(number)?;
            }
        }
        Ok(())
    }

    /// Waits for the next message of a topic.
    fn wait_for(&mut self, number: usize) -> Result<(), RecordError> {
        let topic = &mut self.topics[number];
        topic.wait = match self.set.add(&topic.subscriber, Event::Topic(number)) {
            Ok(key) => Wait::Message(key),
            Err(error) if is_shortage(&error) => {
                self.is_short = true;
                Wait::Room
            }
            Err(error) => return Err(RecordError::System(error)),
        };
        Ok(())
    }

    /// Looks for a step of the wall clock.
    fn compare_clocks(&mut self) {
        let options = &self.options;
        let clock = ClockRelation::read(options.wall_clock, options.monotonic_clock);
        if self.last_clock.step_to(&clock) >= STEP_MIN {
            self.last_clock = clock;
            self.queue.push(Item::Clock(clock));
        }
    }
}
