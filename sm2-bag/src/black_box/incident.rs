//! Writing the bag of an incident.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use std::time::Duration;

use mcap::records::Metadata;
use sm2_proto::Instant;

use crate::bag::Bag;
use crate::copy::{CopyOptions, copy_into, create_new, write_error};
use crate::error::{CopyError, WriteError};
use crate::incident_record;
use crate::messages::Filter;
use crate::names::{create_first, numbered};
use crate::observer::unobserved;
use crate::recorder::Recorder;
use crate::report::Report;
use crate::shift::Shift;
use crate::storage;
use crate::writer::Compression;

/// After this time, a bag that found no room on the disk is written again.
const RETRY: Duration = Duration::from_millis(200);

/// An incident, and the bag with the messages around it.
#[derive(Debug)]
pub struct Incident {
    /// The bag.
    pub path: PathBuf,
    /// The trigger.
    pub reason: String,
    /// The summary of the bag, unless it could not be written.
    pub result: Result<Report, CopyError>,
    /// How many more triggers it stands for, because there were too many of them.
    pub merged: u64,
    pub(super) from_ns: u64,
}

/// The time around a trigger.
#[derive(Debug)]
pub(super) struct Window {
    pub(super) from_ns: u64,
    pub(super) to_ns: u64,
    /// Whether the recorder was told to end the file where the time ends.
    pub(super) has_ended_file: bool,
    pub(super) waits_for_room: bool,
    /// How many more triggers were merged into it.
    merged: u64,
    at_ns: u64,
    reason: String,
    pub(super) path: PathBuf,
    /// The file, which is empty until the time has ended. `None` after a copy that found no room on the disk.
    file: Option<io::Result<File>>,
    /// When the bag may be written again after that.
    try_at: Instant,
}

impl Window {
    pub(super) fn new(
        at_ns: u64,
        (last, after): (Duration, Duration),
        reason: &str,
        folder: &Path,
    ) -> Self {
        let time = jiff::Timestamp::from_nanosecond(at_ns.into()).unwrap_or_default();
        let stem = format!("incident-{}", time.strftime("%Y-%m-%d-%H%M%S"));
        let path = |number| folder.join(format!("{}.mcap", numbered(&stem, number)));
        let (path, file) = create_first(path, create_new);
        Self {
            from_ns: at_ns.saturating_sub(last.as_nanos() as u64),
            to_ns: at_ns.saturating_add(after.as_nanos() as u64),
            has_ended_file: false,
            waits_for_room: false,
            merged: 0,
            at_ns,
            reason: reason.to_owned(),
            path,
            file: Some(file),
            try_at: Instant(0),
        }
    }

    /// Whether a trigger at this time can be merged into it: its time has not passed, and is not much extended yet.
    pub(super) fn can_have(&self, at_ns: u64, extension: Duration) -> bool {
        at_ns < self.to_ns && Duration::from_nanos(at_ns.saturating_sub(self.at_ns)) < extension
    }

    /// Merges a further trigger into it. The time after that trigger is kept as well, unless it is too late.
    pub(super) fn merge(&mut self, at_ns: u64, after: Duration) {
        self.merged += 1;
        if at_ns < self.to_ns {
            let to_ns = at_ns.saturating_add(after.as_nanos() as u64);
            self.to_ns = self.to_ns.max(to_ns);
            self.has_ended_file = false;
        }
    }

    /// Whether the disk has room for the bag, which is not longer than the files.
    pub(super) fn has_room(&self, files: &[PathBuf], recorder: &Recorder<'_>) -> bool {
        let lengths = files.iter().flat_map(fs::metadata).map(|it| it.len());
        match &self.file {
            // If that is unknown, writing tells.
            Some(Ok(file)) => recorder.has_room(file, lengths.sum()).unwrap_or(true),
            Some(Err(_)) => true,
            None => sm2_io::clock::now() >= self.try_at,
        }
    }

    fn metadata(&self) -> Metadata {
        let content = [
            ("reason", self.reason.clone()),
            (incident_record::AT, self.at_ns.to_string()),
            (incident_record::FROM, self.from_ns.to_string()),
            (incident_record::TO, self.to_ns.to_string()),
            ("merged", self.merged.to_string()),
        ];
        Metadata {
            name: incident_record::RECORD.to_owned(),
            metadata: BTreeMap::from(content.map(|(key, value)| (key.to_owned(), value))),
        }
    }

    /// Copies the messages of this time out of the ring. If the disk has no room, nothing remains of the copy.
    fn copy(&mut self, files: &[PathBuf]) -> Result<Report, CopyError> {
        let metadata = [self.metadata()];
        let file = self.file.take().unwrap_or_else(|| create_new(&self.path));
        let file = file.map_err(|error| write_error(&self.path, error.into()))?;
        let bags: Vec<_> = files
            .iter()
            .map(|it| Bag::open(it))
            .collect::<Result<_, _>>()?;
        let filter = Filter {
            from_ns: Some(self.from_ns),
            to_ns: Some(self.to_ns),
            ..Filter::default()
        };
        let options = CopyOptions {
            filter: &filter,
            compression: Compression::None,
            metadata: &metadata,
            shift: Shift::default(),
        };
        copy_into(&file, &bags, &self.path, &options, &mut unobserved)
    }
}

/// Whether a copy has failed because the disk is full.
fn is_full(copied: &Result<Report, CopyError>) -> bool {
    let Err(CopyError::Write { source, .. }) = copied else {
        return false;
    };
    matches!(source, WriteError::Io(error) if storage::is_full(error))
}

/// A thread that writes the bag of an incident.
pub(super) struct Copying {
    pub(super) path: PathBuf,
    reason: String,
    merged: u64,
    from_ns: u64,
    thread: io::Result<JoinHandle<(Window, Result<Report, CopyError>)>>,
}

impl Copying {
    pub(super) fn start(mut window: Window, files: Vec<PathBuf>) -> Self {
        let (path, reason) = (window.path.clone(), window.reason.clone());
        let (merged, from_ns) = (window.merged, window.from_ns);
        let work = move || {
            let copied = window.copy(&files);
            (window, copied)
        };
        Self {
            path,
            reason,
            merged,
            from_ns,
            thread: sm2_io::spawn_without_signals("sm2-incident".to_owned(), work),
        }
    }

    pub(super) fn is_done(&self) -> bool {
        (self.thread.as_ref()).map_or(true, JoinHandle::is_finished)
    }

    /// As [`join`](Self::join). Returns the window instead if the disk had no room: it may have some later.
    pub(super) fn join_or_retry(self) -> Result<Incident, Window> {
        let (incident, window) = self.join_both();
        let window = window.filter(|_| is_full(&incident.result));
        window.map_or(Ok(incident), |window| {
            Err(Window {
                try_at: sm2_io::clock::now().after(RETRY),
                ..window
            })
        })
    }

    /// Waits for the thread.
    pub(super) fn join(self) -> Incident {
        self.join_both().0
    }

    fn join_both(self) -> (Incident, Option<Window>) {
        let failed = |source| CopyError::Write {
            path: self.path.clone(),
            source,
        };
        let (window, result) = match self.thread.map(JoinHandle::join) {
            Ok(Ok((window, result))) => (Some(window), result),
            Ok(Err(_)) => (None, Err(failed(WriteError::Panicked))),
            Err(error) => (None, Err(failed(error.into()))),
        };
        let incident = Incident {
            path: self.path,
            reason: self.reason,
            result,
            merged: self.merged,
            from_ns: self.from_ns,
        };
        (incident, window)
    }
}
