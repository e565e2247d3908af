//! The store of an outbox: a folder of MCAP files.

mod error;
mod file;

use std::collections::VecDeque;
use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use sm2_proto::Instant;

pub use self::error::StoreError;
use self::file::{StoreFile, Writing};
use crate::Durable;
use crate::spool::{Id, Spool};

/// The file that reserves a folder for one outbox.
const LOCK: &str = "lock";
/// How long a file may become before the next one is begun, in bytes.
const SEGMENT_MAX_BYTES: u64 = 8 << 20;

/// Messages in files, each in the file that was the newest one when it came. A file is removed when all of its messages
/// have their fate.
///
/// A message is in the page cache when [`put`](Self::put) returns, so it survives the death of the program, and may be
/// lost if the machine stops. Messages of the newest file, and those of one older file, are in memory as well.
#[derive(Debug)]
pub(crate) struct Store {
    folder: PathBuf,
    _lock: Flock<File>,
    /// The number of the next file.
    next_file: u64,
    /// Closed files, oldest first.
    closed: VecDeque<StoreFile>,
    writing: Option<Writing>,
    /// The messages of one closed file, by its first message.
    loaded: Option<(Id, Vec<Durable>)>,
}

impl Store {
    /// Opens a folder, which is made if it is missing, and [restores](Spool::restore) its messages. `wall` is the
    /// present time, in nanoseconds since 1970 (UTC).
    pub(crate) fn open(
        folder: &Path,
        spool: &mut Spool,
        now: Instant,
        wall: u64,
    ) -> Result<Self, StoreError> {
        fs::create_dir_all(folder).map_err(StoreError::io("make", folder))?;
        let mut store = Self {
            folder: folder.to_owned(),
            _lock: lock(folder)?,
            next_file: 0,
            closed: VecDeque::new(),
            writing: None,
            loaded: None,
        };
        for (number, path) in files(folder)? {
            store.next_file = number + 1;
            let messages = file::read(&path)?;
            let mut ids = messages.iter().map(|it| {
                let age = Duration::from_nanos(wall.saturating_sub(it.time));
                spool.restore(it.payload.len() as u64, age, now)
            });
            match ids.next() {
                Some(first) => {
                    let len = 1 + ids.count() as u64;
                    store.closed.push_back(StoreFile::new(path, first, len));
                }
                None => file::remove(&path)?,
            }
        }
        Ok(store)
    }

    /// Stores a message. Its number is greater than those before.
    pub(crate) fn put(&mut self, id: Id, message: Durable) -> Result<(), StoreError> {
        // The messages of a file have numbers without a gap.
        if (self.writing.as_ref())
            .is_some_and(|it| it.next() != id || it.len_bytes() >= SEGMENT_MAX_BYTES)
        {
            self.close(Writing::close)?;
        }
        let writing = match &mut self.writing {
            Some(writing) => writing,
            empty => {
                let path = self.folder.join(format!("{:016}.mcap", self.next_file));
                self.next_file += 1;
                empty.insert(Writing::create(path, id)?)
            }
        };
        let stored = writing.append(message);
        if stored.is_err() {
            self.close(Writing::cut)?;
        }
        stored
    }

    /// A message that has no fate yet.
    pub(crate) fn get(&mut self, id: Id) -> Result<Durable, StoreError> {
        if let Some(message) = self.writing.as_ref().and_then(|it| it.get(id)) {
            return Ok(message.clone());
        }
        let file = self.closed_with(id).map(|it| &self.closed[it]);
        let file = file.ok_or_else(|| StoreError::Damaged {
            path: self.folder.clone(),
        })?;
        let damaged = || StoreError::Damaged {
            path: file.path().to_owned(),
        };
        let messages = match &mut self.loaded {
            Some((first, messages)) if *first == file.first() => messages,
            loaded => &mut loaded.insert((file.first(), file::read(file.path())?)).1,
        };
        let index = usize::try_from(id.0 - file.first().0).unwrap_or(usize::MAX);
        messages.get(index).cloned().ok_or_else(damaged)
    }

    /// A message has its fate. Without effect for one that is not stored.
    pub(crate) fn end(&mut self, id: Id) -> Result<(), StoreError> {
        if let Some(writing) = &mut self.writing
            && writing.end(id)
        {
            return Ok(());
        }
        let Some(index) = self.closed_with(id) else {
            return Ok(());
        };
        if self.closed[index].end() {
            return self.remove(index);
        }
        Ok(())
    }

    /// The closed file that has a message.
    fn closed_with(&self, id: Id) -> Option<usize> {
        let after = self.closed.partition_point(|it| it.first() <= id);
        let index = after.checked_sub(1)?;
        self.closed[index].has(id).then_some(index)
    }

    /// Ends the newest file.
    fn close(
        &mut self,
        close: fn(Writing) -> Result<StoreFile, StoreError>,
    ) -> Result<(), StoreError> {
        let Some(writing) = self.writing.take() else {
            return Ok(());
        };
        let file = close(writing)?;
        let is_done = file.is_done();
        self.closed.push_back(file);
        match is_done {
            true => self.remove(self.closed.len() - 1),
            false => Ok(()),
        }
    }

    fn remove(&mut self, index: usize) -> Result<(), StoreError> {
        let Some(file) = self.closed.remove(index) else {
            return Ok(());
        };
        self.loaded.take_if(|(first, _)| *first == file.first());
        file::remove(file.path())
    }
}

fn lock(folder: &Path) -> Result<Flock<File>, StoreError> {
    let path = folder.join(LOCK);
    let file = OpenOptions::new()
        .create(true)
        .truncate(false)
        .write(true)
        .open(&path);
    let file = file.map_err(StoreError::io("open", &path))?;
    Flock::lock(file, FlockArg::LockExclusiveNonblock).map_err(|(_, error)| match error {
        Errno::EWOULDBLOCK => StoreError::Locked {
            path: folder.to_owned(),
        },
        other => StoreError::io("lock", &path)(other.into()),
    })
}

/// The files of a folder with their numbers, oldest first.
fn files(folder: &Path) -> Result<Vec<(u64, PathBuf)>, StoreError> {
    let read = StoreError::io("read", folder);
    let mut files = Vec::new();
    let entries: io::Result<Vec<_>> = fs::read_dir(folder).and_then(Iterator::collect);
    for entry in entries.map_err(read)? {
        let path = entry.path();
        let is_mcap = path.extension().is_some_and(|it| it == "mcap");
        let number = path.file_stem().and_then(|it| it.to_str()?.parse().ok());
        if let Some(number) = number.filter(|_| is_mcap) {
            files.push((number, path));
        }
    }
    files.sort_unstable();
    Ok(files)
}
