//! The files of a recording.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use sm2_proto::Name;

use super::options::Options;
use super::room::Room;
use crate::clock::ClockRelation;
use crate::error::WriteError;
use crate::folder::Folder;
use crate::gap::Gap;
use crate::latched::Kept;
use crate::missing::MissingTopic;
use crate::queue::Queue;
use crate::report::{Report, ReportBuilder};
use crate::source::Source;
use crate::storage::{FreeBytes, Storage};
use crate::writer::{BagWriter, Compression, Done, LongMessage, MessageTimes};
use crate::written_by::WrittenBy;

/// One part in so many of the budget may be used to keep the latched state for the next file.
const KEPT_SHARE: u64 = 4;

/// When a recording begins a new file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Split {
    /// Before a file becomes longer than this, in bytes.
    pub bytes: Option<u64>,
    /// When the messages of a file are this long after its first one.
    pub time: Option<Duration>,
}

/// Where a recording goes.
pub(crate) enum Output {
    File(Box<dyn Storage>),
    Folder(Folder, Split),
}

/// Writes the files of a recording, one after the other.
pub(crate) struct Parts {
    bag: BagWriter,
    room: Room,
    /// The folder, unless there is one file only.
    folder: Option<(Folder, Split)>,
    /// The latched state for the next file of the folder.
    kept: Kept,
    /// Whether the file has a message that is not repeated.
    has_messages: bool,
    by: WrittenBy,
    compression: Compression,
    free_bytes: FreeBytes,
    min_free_bytes: u64,
    /// The relation of the clocks at the start, and after the last step of the wall clock.
    clocks: (ClockRelation, ClockRelation),
    /// The topics that are not recorded now.
    missing: BTreeMap<String, MissingTopic>,
    /// The content of the files that are complete.
    done: ReportBuilder,
}

impl Parts {
    pub(crate) fn new(
        output: Output,
        options: &Options,
        clock: ClockRelation,
        node: &Name,
        queue: Arc<Queue>,
    ) -> Result<Self, WriteError> {
        let by = WrittenBy {
            node: node.to_string(),
            process: std::process::id(),
            since_ns: clock.wall_ns,
        };
        let (storage, folder) = match output {
            Output::File(storage) => (storage, None),
            Output::Folder(folder, split) => {
                let file = next_file(&folder, split, options.free_bytes)?;
                (file, Some((folder, split)))
            }
        };
        let room = Room {
            queue,
            folder: folder.as_ref().map(|it| it.0.clone()),
        };
        let storage = room.file(storage);
        Ok(Self {
            bag: BagWriter::new(storage, options.compression, clock, &by)?,
            room,
            by,
            folder,
            kept: Kept::new(options.budget_bytes / KEPT_SHARE),
            has_messages: false,
            compression: options.compression,
            free_bytes: options.free_bytes,
            min_free_bytes: options.min_free_bytes,
            clocks: (clock, clock),
            missing: BTreeMap::new(),
            done: ReportBuilder::default(),
        })
    }

    pub(crate) fn message(
        &mut self,
        source: &Arc<Source>,
        times: MessageTimes,
        data: &[u8],
    ) -> Result<(), WriteError> {
        self.make_room(source, times.log_time, data.len())?;
        self.keep(source, times, data);
        self.bag.message(source, times, data)
    }

    pub(crate) fn long_message(
        &mut self,
        source: &Arc<Source>,
        times: MessageTimes,
        message: LongMessage,
        done: Done,
    ) -> Result<(), WriteError> {
        self.make_room(source, times.log_time, message.len())?;
        self.keep(source, times, &message);
        self.bag.long_message(source, times, message, done)
    }

    /// Keeps a message that is about to be written.
    fn keep(&mut self, source: &Arc<Source>, times: MessageTimes, data: &[u8]) {
        self.has_messages = true;
        if self.folder.is_some() {
            self.kept.keep(source, times, data);
        }
    }

    /// A latched publisher has left.
    pub(crate) fn left(&mut self, source: &Arc<Source>) {
        self.kept.forget(source);
    }

    /// Begins the next file if a message belongs to it.
    fn make_room(&mut self, source: &Arc<Source>, time: u64, len: usize) -> Result<(), WriteError> {
        match self.is_full(time, len as u64) || self.bag.lacks_channel(source) {
            true => self.end_file(time),
            false => Ok(()),
        }
    }

    /// Whether a message belongs to the next file.
    fn is_full(&self, time: u64, len_bytes: u64) -> bool {
        let Some((_, split)) = &self.folder else {
            return false;
        };
        let Some((first, _)) = self.bag.times().filter(|_| self.has_messages) else {
            return false;
        };
        let is_long = split
            .bytes
            .is_some_and(|it| self.bag.len_bytes() + len_bytes > it);
        let age = Duration::from_nanos(time.saturating_sub(first));
        is_long || split.time.is_some_and(|it| age >= it)
    }

    pub(crate) fn gap(&mut self, source: &Arc<Source>, gap: Gap) -> Result<(), WriteError> {
        if self.bag.lacks_channel(source) {
            self.end_file(gap.to_ns)?;
        }
        self.bag.gap(source, gap)
    }

    pub(crate) fn clock(&mut self, clock: ClockRelation) -> Result<(), WriteError> {
        self.clocks.1 = clock;
        self.bag.clock(clock)
    }

    pub(crate) fn missing(&mut self, missing: MissingTopic) -> Result<(), WriteError> {
        match missing.to_ns {
            Some(_) => self.missing.remove(&missing.topic),
            None => self.missing.insert(missing.topic.clone(), missing.clone()),
        };
        self.bag.missing(missing)
    }

    pub(crate) fn not_recorded(&mut self, topics: u64) -> Result<(), WriteError> {
        self.bag.not_recorded(topics)
    }

    /// Ends an interval. When [`end_sync`](Self::end_sync) returns, everything that was written before can be read
    /// after a power cut. The error may be that of the interval before.
    pub(crate) fn begin_sync(&mut self) -> Result<(), WriteError> {
        self.bag.begin_sync()
    }

    /// Waits until the last interval is on the disk.
    pub(crate) fn end_sync(&mut self) -> Result<(), WriteError> {
        self.bag.end_sync()
    }

    /// Whether the disk has less free space than the recording has to leave. The oldest files of a ring are removed
    /// first.
    pub(crate) fn is_disk_full(&mut self) -> Result<bool, WriteError> {
        loop {
            let free = self.bag.free_bytes()?;
            if free.is_none_or(|it| it >= self.min_free_bytes) {
                return Ok(false);
            }
            let can_remove = match &self.folder {
                Some((folder, _)) if folder.is_ring() => folder.remove_oldest()?,
                _ => false,
            };
            if !can_remove {
                return Ok(true);
            }
        }
    }

    /// Ends the file, and begins the next one. Nothing happens without a folder.
    pub(crate) fn end_file(&mut self, now_ns: u64) -> Result<(), WriteError> {
        let Some((folder, split)) = self.folder.clone() else {
            return Ok(());
        };
        self.complete(now_ns)?;
        let (start, last) = self.clocks;
        let file = || next_file(&folder, split, self.free_bytes);
        let file = self.room.run(file)?;
        self.by.since_ns = now_ns;
        self.bag = BagWriter::new(self.room.file(file), self.compression, start, &self.by)?;
        if last != start {
            self.bag.clock(last)?;
        }
        // Each file says what it lacks.
        for missing in self.missing.values() {
            self.bag.missing(missing.clone())?;
        }
        self.has_messages = false;
        let most_bytes = split.bytes.map_or(u64::MAX, |it| it / 2);
        self.kept.repeat(&mut self.bag, now_ns, most_bytes)
    }

    /// Ends the last file. Returns the content of all files together.
    pub(crate) fn finish(mut self, now_ns: u64) -> Result<Report, WriteError> {
        self.complete(now_ns)?;
        Ok(self.done.finish_all(true))
    }

    /// Completes the file, which has everything up to `now_ns`.
    fn complete(&mut self, now_ns: u64) -> Result<(), WriteError> {
        let (len_bytes, times) = (self.bag.len_bytes(), self.bag.times());
        self.done.add_report(&self.bag.finish()?);
        if let Some((folder, _)) = &self.folder {
            folder.end_file(len_bytes, times, now_ns)?;
        }
        Ok(())
    }
}

fn next_file(folder: &Folder, split: Split, free_bytes: FreeBytes) -> io::Result<Box<dyn Storage>> {
    let file = folder.next_file(split.bytes.unwrap_or_default())?;
    Ok(Box::new(file.with_free_bytes(free_bytes)))
}

#[cfg(test)]
mod tests {
    use super::super::options::Topics;
    use super::*;
    use crate::bag::Bag;
    use crate::storage::BagFile;
    use crate::writer::CHANNELS_MAX;

    fn source(publisher: usize) -> Arc<Source> {
        Source::of_test(&format!("talker/{publisher}"), 0)
    }

    /// A process that joins, publishes and leaves again and again makes a channel each time.
    #[test]
    fn a_file_with_too_many_publishers_is_followed_by_another_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.mcap");
        let files = Folder::of_file(&path, BagFile::create(&path).unwrap());
        let options = Options::new(Topics::All);
        let clock = ClockRelation::read(options.wall_clock, options.monotonic_clock);
        let output = Output::Folder(files, Split::default());
        let node = Name::new("recorder").unwrap();
        let queue = Arc::new(Queue::new(options.budget_bytes).unwrap());
        let mut parts = Parts::new(output, &options, clock, &node, queue).unwrap();
        let times = MessageTimes {
            sequence: 1,
            log_time: 7,
            publish_time: 7,
        };
        let publishers = CHANNELS_MAX + 2;
        let first = source(0);
        for publisher in 0..publishers {
            parts.message(&source(publisher), times, b"1").unwrap();
        }
        // It is a channel of the first file only.
        parts.message(&first, times, b"2").unwrap();
        let report = parts.finish(8).unwrap();
        let count = |path: &std::path::Path| Bag::open(path).unwrap().report().topics[0].messages;
        let second = folder.path().join("drive-2.mcap");
        assert_eq!((count(&path), count(&second)), (CHANNELS_MAX as u64, 3));
        assert_eq!(report.topics[0].messages, publishers as u64 + 1);
    }
}
