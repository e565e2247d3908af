//! A folder of bags that one recording fills one after the other.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::bag::Bag;
use crate::storage::BagFile;

/// A folder of bags that one recording fills one after the other: `STEM-0001.mcap`, `STEM-0002.mcap`, and so forth.
///
/// With a [limit](Self::keep_bytes), the folder is a ring: before a new file begins, the oldest ones are removed.
/// Clones are the same folder.
#[derive(Clone, Debug)]
pub struct Folder(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    path: PathBuf,
    stem: String,
    /// The first file, and its path, if it has a name of its own.
    first: Option<(PathBuf, BagFile)>,
    naming: Naming,
    /// The number of files of this recording.
    created: u32,
    /// The number in the name of the last file.
    number: u64,
    /// The folder, locked against other recorders. `None` if several may use it.
    lock: Option<File>,
    /// The number of files that were removed.
    removed: u32,
    keep_bytes: Option<u64>,
    keep_for: Option<Duration>,
    /// Files are kept whose messages end at this time or later.
    pinned_ns: Vec<u64>,
    /// The file that is being written.
    open: Option<PathBuf>,
    /// The complete files, the oldest one first.
    parts: VecDeque<Part>,
    /// The recording is in complete files up to this time.
    covered_ns: u64,
}

/// The names of files behind their stem.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Naming {
    /// `STEM-0001.mcap`, `STEM-0002.mcap`, and so forth.
    FourDigits,
    /// `STEM-2.mcap`, `STEM-3.mcap`, and so forth, behind a first file of another name.
    Behind,
}

/// A complete file.
#[derive(Debug)]
struct Part {
    path: PathBuf,
    len_bytes: u64,
    /// The `log_time` of the first and of the last message; `None` without a message, or for a file that was there
    /// before.
    times: Option<(u64, u64)>,
}

impl Folder {
    /// Records into the folder `path`, which is created unless it exists.
    ///
    /// # Errors
    ///
    /// Any error of the operating system.
    pub fn new(path: &Path, stem: &str) -> io::Result<Self> {
        fs::create_dir_all(path)?;
        Ok(Self::of(path.to_owned(), stem.to_owned(), None))
    }

    /// Records into the new file `first` of this path. If one file cannot have all publishers, because MCAP has 16 bits
    /// for them, further ones follow beside it: `STEM-2.mcap`, and so forth.
    #[must_use]
    pub fn of_file(path: &Path, first: BagFile) -> Self {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let folder = path.parent().unwrap_or(Path::new(""));
        let first = Some((path.to_owned(), first));
        Self::of(folder.to_owned(), stem.into_owned(), first)
    }

    fn of(path: PathBuf, stem: String, first: Option<(PathBuf, BagFile)>) -> Self {
        let naming = match first {
            Some(_) => Naming::Behind,
            None => Naming::FourDigits,
        };
        Self(Arc::new(Mutex::new(State {
            path,
            stem,
            first,
            naming,
            created: 0,
            number: 0,
            lock: None,
            removed: 0,
            keep_bytes: None,
            keep_for: None,
            pinned_ns: Vec::new(),
            open: None,
            parts: VecDeque::new(),
            covered_ns: 0,
        })))
    }

    /// Limits the length of all files together, in bytes. The bags of earlier recordings whose names begin with
    /// `prefix` belong to the ring, too: they are removed first, in the order of their names.
    ///
    /// # Errors
    ///
    /// Any error of reading the folder.
    pub fn keep_bytes(self, limit: u64, prefix: &str) -> io::Result<Self> {
        let mut state = self.lock();
        let mut before = Vec::new();
        for entry in fs::read_dir(&state.path)? {
            let entry = entry?;
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name.starts_with(prefix) && name.ends_with(".mcap") && entry.file_type()?.is_file() {
                before.push(Part {
                    path: entry.path(),
                    len_bytes: entry.metadata()?.len(),
                    times: None,
                });
            }
        }
        before.sort_by(|a, b| a.path.cmp(&b.path));
        state.parts = before.into();
        state.keep_bytes = Some(limit);
        drop(state);
        Ok(self)
    }

    /// Removes files whose messages are older than this. The files with the stem of this folder that a recorder has
    /// left, because it was killed, belong to the ring. No other recorder can use the folder meanwhile. `now_ns` is the
    /// time of the wall clock.
    ///
    /// # Errors
    ///
    /// `WouldBlock` if another recorder uses the folder, and any error of the operating system.
    pub(crate) fn keep_for(self, age: Duration, now_ns: u64) -> io::Result<Self> {
        let mut state = self.lock();
        let folder = File::open(&state.path)?;
        sm2_io::lock_file(&folder)?;
        state.lock = Some(folder);
        let mut left = Vec::new();
        for entry in fs::read_dir(&state.path)? {
            let path = entry?.path();
            if let Some(number) = state.number_of(&path) {
                left.push((number, path));
            }
        }
        left.sort_unstable();
        for (number, path) in left {
            state.number = number;
            let len_bytes = fs::metadata(&path)?.len();
            // A file that cannot be read has no messages. Messages of a later time are of another setting of the clock:
            // no trigger asks for them.
            let times = Bag::open(&path).ok().and_then(|it| it.times());
            let times = times.filter(|(_, last)| *last <= now_ns);
            state.parts.push_back(Part {
                path,
                len_bytes,
                times,
            });
        }
        state.keep_for = Some(age);
        drop(state);
        Ok(self)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The number of files that the recording has begun, and the number of files that were removed.
    #[must_use]
    pub fn counts(&self) -> (u32, u32) {
        let state = self.lock();
        (state.created, state.removed)
    }

    /// Whether old files are removed.
    pub(crate) fn is_ring(&self) -> bool {
        let state = self.lock();
        state.keep_bytes.is_some() || state.keep_for.is_some()
    }

    /// Begins the next file, which may grow to `reserve_bytes`.
    pub(crate) fn next_file(&self, reserve_bytes: u64) -> io::Result<BagFile> {
        let mut state = self.lock();
        if let Some(limit) = state.keep_bytes {
            while state.len_bytes().saturating_add(reserve_bytes) > limit {
                if !state.remove_oldest()? {
                    break;
                }
            }
        }
        if let Some((path, file)) = state.first.take() {
            state.number = 1;
            state.created = 1;
            state.open = Some(path);
            return Ok(file);
        }
        loop {
            state.number += 1;
            let path = state.path.join(state.name());
            match BagFile::create(&path) {
                // Of another recording: a clock without a battery gives two of them the same stem.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
                Ok(file) => {
                    state.created += 1;
                    state.open = Some(path);
                    return Ok(file);
                }
            }
        }
    }

    /// The file that was being written is complete, and has everything up to `now_ns`.
    pub(crate) fn end_file(
        &self,
        len_bytes: u64,
        times: Option<(u64, u64)>,
        now_ns: u64,
    ) -> io::Result<()> {
        let mut state = self.lock();
        if let Some(path) = state.open.take() {
            state.parts.push_back(Part {
                path,
                len_bytes,
                times,
            });
        }
        state.covered_ns = state.covered_ns.max(now_ns);
        if let Some(age) = state.keep_for {
            let from = now_ns.saturating_sub(age.as_nanos() as u64);
            while state.parts.front().is_some_and(|it| it.ends_before(from)) {
                if !state.remove_oldest()? {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Removes the oldest complete file to make room. Returns whether there was one.
    pub(crate) fn remove_oldest(&self) -> io::Result<bool> {
        self.lock().remove_oldest()
    }

    /// Keeps files whose messages end at `from_ns` or later, until they are [released](Self::release).
    pub(crate) fn pin(&self, from_ns: u64) {
        self.lock().pinned_ns.push(from_ns);
    }

    pub(crate) fn release(&self, from_ns: u64) {
        let mut state = self.lock();
        if let Some(at) = state.pinned_ns.iter().position(|it| *it == from_ns) {
            state.pinned_ns.swap_remove(at);
        }
    }

    /// The complete files with messages of these times; `None` until complete files have everything up to `to_ns`.
    pub(crate) fn files(&self, from_ns: u64, to_ns: u64) -> Option<Vec<PathBuf>> {
        let state = self.lock();
        (state.covered_ns >= to_ns).then(|| {
            let overlaps = |part: &&Part| {
                part.times
                    .is_some_and(|(first, last)| first < to_ns && last >= from_ns)
            };
            let parts = state.parts.iter().filter(overlaps);
            parts.map(|it| it.path.clone()).collect()
        })
    }

    /// All files, also the one that is being written.
    pub(crate) fn all_files(&self) -> Vec<PathBuf> {
        let state = self.lock();
        let complete = state.parts.iter().map(|it| &it.path);
        complete.chain(&state.open).cloned().collect()
    }

    /// Removes all complete files, and the folder if it is empty then.
    pub(crate) fn remove(&self) -> io::Result<()> {
        let mut state = self.lock();
        state.pinned_ns.clear();
        while state.remove_oldest()? {}
        match fs::remove_dir(&state.path) {
            Err(error) if error.kind() == io::ErrorKind::DirectoryNotEmpty => Ok(()),
            result => result,
        }
    }
}

impl State {
    /// The name of the file with the present number.
    fn name(&self) -> String {
        let Self { stem, number, .. } = self;
        match self.naming {
            Naming::FourDigits => format!("{stem}-{number:04}.mcap"),
            Naming::Behind => format!("{stem}-{number}.mcap"),
        }
    }

    /// The number in the name of a file of this folder; `None` for another file.
    fn number_of(&self, path: &Path) -> Option<u64> {
        let name = path.file_name()?.to_str()?;
        let number = name.strip_prefix(&self.stem)?.strip_prefix('-')?;
        number.strip_suffix(".mcap")?.parse().ok()
    }

    /// The length of all complete files, in bytes.
    fn len_bytes(&self) -> u64 {
        self.parts.iter().map(|it| it.len_bytes).sum()
    }

    /// Removes the oldest complete file. Returns false if there is none, or if it is pinned.
    fn remove_oldest(&mut self) -> io::Result<bool> {
        let Some(oldest) = self.parts.front() else {
            return Ok(false);
        };
        let is_pinned = |from: &u64| !oldest.ends_before(*from);
        if self.pinned_ns.iter().any(is_pinned) {
            return Ok(false);
        }
        match fs::remove_file(&oldest.path) {
            // Somebody else has removed it.
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        self.removed += 1;
        self.parts.pop_front();
        Ok(true)
    }
}

impl Part {
    /// Whether all its messages are older than `from_ns`.
    fn ends_before(&self, from_ns: u64) -> bool {
        self.times.is_none_or(|(_, last)| last < from_ns)
    }
}
