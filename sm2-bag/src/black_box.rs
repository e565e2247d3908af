//! A recording of the last seconds, which is kept when something happens.
//!
//! A black box is a recorder with a ring of files. A trigger pins the files of its time (`folder.rs`). When the time
//! after the trigger has passed, the recorder ends its current file, and a thread copies the messages of the time out
//! of the complete files into a bag. Triggers can therefore overlap, the recorder keeps nothing in its memory, and a
//! crash leaves the ring.

mod incident;
mod limit;
mod triggers;

use std::io;
use std::os::fd::BorrowedFd;
use std::path::PathBuf;
use std::time::Duration;

use sm2_node::domain::Domain;
use sm2_node::{ConnectError, Node};
use sm2_proto::Instant;

pub use self::incident::Incident;
use self::incident::{Copying, Window};
use self::limit::Limit;
pub use self::triggers::Trigger;
use self::triggers::Triggers;
use crate::error::RecordError;
use crate::folder::Folder;
use crate::recorder::{Options, Progress, Recorder, Split, Step};

/// So many incidents may wait, for their time to pass or for room on the disk.
const OPEN_MAX: usize = 64;
/// How often a black box looks whether the file of an incident is complete.
const LOOK: Duration = Duration::from_millis(20);
/// How often a black box looks whether the disk has room for an incident.
const LOOK_FOR_ROOM: Duration = Duration::from_millis(200);
/// The ring of a black box is divided into this many files, so that little more than the last seconds is kept.
const RING_FILES: u32 = 8;
/// The shortest time of a file in the ring.
const FILE_MIN: Duration = Duration::from_secs(1);

/// The options of a black box.
#[derive(Clone, Debug)]
pub struct BlackBoxOptions {
    /// The recording.
    pub record: Options,
    /// How much before a trigger is kept.
    pub last: Duration,
    /// How much after a trigger is kept.
    pub after: Duration,
    /// The triggers.
    pub triggers: Vec<Trigger>,
    /// The folder for the bags of incidents. It must exist.
    pub output: PathBuf,
    /// The folder for the files of the ring, which no other program uses. In a memory file system (such as
    /// `/dev/shm`), nothing is written to a disk before a trigger.
    pub ring: PathBuf,
}

/// Why [`BlackBox::step`] has returned.
#[derive(Debug)]
pub enum BlackBoxStep {
    /// The time is over.
    Timeout,
    /// The descriptor `stop` is readable.
    Stopped,
    /// A descriptor of [`wake_on_descriptor`](BlackBox::wake_on_descriptor) may be ready.
    Woken,
    /// The bag of an incident waits until its disk has room: it would use up the [reserve](Options::min_free_bytes).
    NoRoom(PathBuf),
    /// Something has triggered: its name, and the bag that will be written.
    Triggered(String, PathBuf),
    /// The bag of an incident is complete, or could not be written.
    Written(Incident),
}

/// Keeps the last seconds of a domain's messages in a ring of files. A [trigger](Trigger) writes them, and those of the
/// next seconds, to a bag of their own. Each trigger gets a bag, also while another one is being written. Beyond eight
/// triggers at once, and one in the time of `last` and `after` together, they are merged into the newest incident.
///
/// A black box does not end when its disk is full. It drops messages, which become gaps, and the bags of incidents
/// wait.
///
/// After a crash of the recorder, the ring is still there: the next black box with this ring takes it over, so its last
/// seconds are in the bags of the next triggers.
pub struct BlackBox<'fd> {
    recorder: Recorder<'fd>,
    ring: Folder,
    last: Duration,
    after: Duration,
    output: PathBuf,
    triggers: Triggers,
    limit: Limit,
    /// The incidents whose last seconds have not passed, the oldest one first.
    open: Vec<Window>,
    copying: Vec<Copying>,
}

impl<'fd> BlackBox<'fd> {
    /// Starts. The descriptor `stop` ends [`step`](Self::step) when it is readable.
    ///
    /// # Errors
    ///
    /// See [`RecordError`].
    pub fn start(
        node: &Node,
        options: BlackBoxOptions,
        stop: BorrowedFd<'fd>,
    ) -> Result<Self, RecordError> {
        let BlackBoxOptions {
            record,
            last,
            after,
            triggers,
            output,
            ring,
        } = options;
        let file_time = (last / RING_FILES).max(FILE_MIN);
        // A file is removed when its last message is too old for a trigger that comes now.
        let now_ns = (record.wall_clock)().0;
        let ring = Folder::new(&ring, "ring").and_then(|it| it.keep_for(last, now_ns));
        let ring = ring.map_err(|error| match error.kind() {
            io::ErrorKind::WouldBlock => RecordError::RingInUse,
            _ => RecordError::System(error),
        })?;
        let split = Split {
            bytes: None,
            time: Some(file_time),
        };
        let mut recorder = Recorder::start_in(node, ring.clone(), split, record, stop)?;
        recorder.wait_for_room();
        let triggers = Triggers::start(node, triggers, &mut recorder)?;
        Ok(Self {
            recorder,
            ring,
            last,
            after,
            output,
            triggers,
            limit: Limit::new(last.saturating_add(after)),
            open: Vec::new(),
            copying: Vec::new(),
        })
    }

    /// Keeps the last seconds and the next ones. Returns the bag that will be written, and whether it is that of an
    /// earlier trigger, because there are too many of them.
    pub fn trigger(&mut self, reason: &str) -> (PathBuf, bool) {
        let now = self.recorder.now_ns();
        let has_room = self.open.len() < OPEN_MAX;
        let may_begin = has_room && self.limit.admits(now);
        if let Some(newest) = self.open.last_mut()
            && !may_begin
            && (!has_room || newest.can_have(now, self.last))
        {
            newest.merge(now, self.after);
            return (newest.path.clone(), true);
        }
        let window = Window::new(now, (self.last, self.after), reason, &self.output);
        self.ring.pin(window.from_ns);
        let path = window.path.clone();
        self.open.push(window);
        (path, false)
    }

    /// Records for at most `timeout`, or until something else happens: see [`BlackBoxStep`].
    ///
    /// # Errors
    ///
    /// See [`RecordError`].
    pub fn step(&mut self, timeout: Duration) -> Result<BlackBoxStep, RecordError> {
        let until = sm2_io::clock::now().after(timeout);
        loop {
            if let Some(step) = self.due()? {
                return Ok(step);
            }
            let now = sm2_io::clock::now();
            if now >= until {
                return Ok(BlackBoxStep::Timeout);
            }
            let next = self.next_time().min(until);
            match self.recorder.step(next.since(now))? {
                Step::Timeout => {}
                Step::Woken => return Ok(self.due()?.unwrap_or(BlackBoxStep::Woken)),
                Step::Stopped => return Ok(BlackBoxStep::Stopped),
                // It waits for room.
                Step::DiskFull => {}
            }
        }
    }

    /// Something that has triggered, or an incident that is complete.
    fn due(&mut self) -> Result<Option<BlackBoxStep>, RecordError> {
        if let Some(reason) = self.triggers.next(&self.recorder)? {
            let (path, is_merged) = self.trigger(&reason);
            self.triggers.answer(&path);
            return Ok(Some(match is_merged {
                true => BlackBoxStep::Woken,
                false => BlackBoxStep::Triggered(reason, path),
            }));
        }
        self.write()
    }

    /// Lets [`step`](Self::step) return when `descriptor` becomes readable.
    ///
    /// # Errors
    ///
    /// Any error of the operating system.
    pub fn wake_on_descriptor(&mut self, descriptor: BorrowedFd<'fd>) -> io::Result<()> {
        self.recorder.wake_on_descriptor(descriptor)
    }

    /// As [`Recorder::connect_with`].
    pub fn connect_with(
        &mut self,
        connect: impl FnMut() -> Result<Node, ConnectError> + Send + 'fd,
    ) {
        self.recorder.connect_with(connect);
    }

    /// As [`Recorder::domain`].
    #[must_use]
    pub const fn domain(&self) -> &Domain {
        self.recorder.domain()
    }

    /// As [`Recorder::unmatched`].
    pub fn unmatched(&mut self) -> Vec<String> {
        self.recorder.unmatched()
    }

    /// How far the recording is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        self.recorder.progress()
    }

    /// The time when something is due.
    fn next_time(&self) -> Instant {
        let now = sm2_io::clock::now();
        let window = self.open.first().map(|window| {
            let left = window.to_ns.saturating_sub(self.recorder.now_ns());
            let least = match window.waits_for_room {
                true => LOOK_FOR_ROOM,
                false => LOOK,
            };
            now.after(Duration::from_nanos(left).max(least))
        });
        let copy = (!self.copying.is_empty()).then(|| now.after(LOOK));
        let times = [window, copy, self.triggers.deadline()];
        times
            .into_iter()
            .flatten()
            .min()
            .unwrap_or(Instant(u64::MAX))
    }

    /// Writes the incidents whose last seconds have passed. Returns one that is complete, or begins to wait for room.
    fn write(&mut self) -> Result<Option<BlackBoxStep>, RecordError> {
        let now = self.recorder.now_ns();
        if let Some(window) = self.open.first_mut()
            && now >= window.to_ns
        {
            match self.ring.files(window.from_ns, window.to_ns) {
                Some(files) if window.has_room(&files, &self.recorder) => {
                    let window = self.open.remove(0);
                    self.copying.push(Copying::start(window, files));
                }
                Some(_) if !std::mem::replace(&mut window.waits_for_room, true) => {
                    return Ok(Some(BlackBoxStep::NoRoom(window.path.clone())));
                }
                Some(_) => {}
                // The last messages are in the file that is being written.
                None if !window.has_ended_file => {
                    window.has_ended_file = true;
                    self.recorder.end_file()?;
                }
                None => {}
            }
        }
        let Some(at) = self.copying.iter().position(Copying::is_done) else {
            return Ok(None);
        };
        match self.copying.remove(at).join_or_retry() {
            Ok(incident) => {
                self.ring.release(incident.from_ns);
                Ok(Some(BlackBoxStep::Written(incident)))
            }
            // Others have filled the disk meanwhile.
            Err(mut window) => {
                let has_said = std::mem::replace(&mut window.waits_for_room, true);
                let path = window.path.clone();
                self.open.insert(0, window);
                Ok((!has_said).then_some(BlackBoxStep::NoRoom(path)))
            }
        }
    }

    /// Ends. Incidents whose last seconds have not passed are written up to now. Then the ring is removed.
    ///
    /// # Errors
    ///
    /// See [`RecordError`]. The ring remains then.
    pub fn finish(self) -> Result<Vec<Incident>, RecordError> {
        let Self {
            recorder,
            ring,
            open,
            copying,
            ..
        } = self;
        let now = recorder.now_ns();
        let recorded = recorder.finish();
        let late = open.into_iter().map(|window| {
            let files = ring.files(window.from_ns, window.to_ns.min(now));
            // After an error, the last file has no summary, and can be read nevertheless.
            Copying::start(window, files.unwrap_or_else(|| ring.all_files()))
        });
        let all: Vec<_> = copying.into_iter().chain(late).collect();
        let incidents: Vec<_> = all.into_iter().map(Copying::join).collect();
        recorded?;
        if incidents.iter().all(|it| it.result.is_ok()) {
            ring.remove().map_err(RecordError::System)?;
        }
        Ok(incidents)
    }
}
