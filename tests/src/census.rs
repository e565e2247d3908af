//! The descriptors and mappings of a process, as the kernel reports them.

use std::{
    collections::{BTreeMap, BTreeSet},
    ffi::OsString,
    fmt, fs,
};

use crate::in_time;

/// The kind of the files with the counters of nodes.
const COUNTERS: &str = "memfd:sm2-counters";

/// The kind of the files with the words that two sides of a link share.
const RING: &str = "memfd:sm2-ring";

/// A kind that includes the descriptors which a Manager holds in reserve for these files.
const PLACE: &str = "anon_inode";

/// Open descriptors by kind, and mappings of memory files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Census {
    kinds: BTreeMap<String, usize>,
    mappings: usize,
    rings: usize,
}

impl Census {
    /// The descriptors and mappings that process `pid` has now.
    #[must_use]
    pub fn of(pid: u32) -> Self {
        Self {
            kinds: descriptors(pid),
            mappings: mappings(pid),
            rings: maps(pid).filter(|line| line.contains(RING)).count(),
        }
    }

    /// The descriptors and mappings that process `pid` has while none of its threads runs.
    ///
    /// A process that works may have one more or one fewer for a moment: a Manager closes a descriptor before each
    /// read, so that it can receive one.
    #[must_use]
    #[track_caller]
    pub fn when_idle(pid: u32) -> Self {
        while_idle(pid, || Self::of(pid))
    }

    /// How many descriptors are open.
    #[must_use]
    pub fn descriptors(&self) -> usize {
        self.kinds.values().sum()
    }

    /// How many descriptors of this kind are open: `socket`, `memfd:sm2-segment`, …
    #[must_use]
    pub fn of_kind(&self, kind: &str) -> usize {
        self.kinds.get(kind).copied().unwrap_or(0)
    }

    /// How many memory files with messages are mapped.
    #[must_use]
    pub const fn mappings(&self) -> usize {
        self.mappings
    }

    /// How many rings are mapped.
    #[must_use]
    pub const fn rings(&self) -> usize {
        self.rings
    }

    /// This census plus the counter files of this many nodes. A node makes its file with its first
    /// declaration, and sends it to its Manager.
    #[must_use]
    pub fn and_counters(&self, nodes: usize) -> Self {
        let mut more = self.clone();
        more.kinds.insert(COUNTERS.to_owned(), nodes);
        more
    }

    /// This census for a Manager, which holds one descriptor in reserve for the counter file of each
    /// session until the file arrives.
    #[must_use]
    pub fn and_counters_in_their_places(&self, nodes: usize) -> Self {
        let mut more = self.and_counters(nodes);
        let places = more.kinds.get_mut(PLACE).expect("places for counters");
        *places -= nodes;
        more
    }

    /// Waits until the process `pid` holds exactly this again.
    #[track_caller]
    pub fn restored(&self, pid: u32) {
        let mut last = self.clone();
        let restored = in_time(|| {
            last = Self::of(pid);
            last == *self
        });
        assert!(
            restored,
            "process {pid} left something behind: {self} before, {last} after"
        );
    }
}

impl fmt::Display for Census {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            kinds,
            mappings,
            rings,
        } = self;
        write!(f, "{kinds:?}, {mappings} mappings and {rings} rings")
    }
}

/// The numbers of the descriptors that process `pid` has while none of its threads runs.
#[must_use]
#[track_caller]
pub fn descriptor_numbers_when_idle(pid: u32) -> BTreeSet<u64> {
    while_idle(pid, || {
        let entries = fs::read_dir(format!("/proc/{pid}/fd")).expect("the process");
        let names = entries.flatten().map(|entry| entry.file_name());
        names
            .filter_map(|name| name.to_str()?.parse().ok())
            .collect()
    })
}

/// The result of `look` for a moment when no thread of the process runs.
#[track_caller]
fn while_idle<T>(pid: u32, mut look: impl FnMut() -> T) -> T {
    let mut seen = None;
    let rested = in_time(|| {
        let before = threads(pid);
        seen = Some(look());
        before.values().all(|it| it.is_asleep) && before == threads(pid)
    });
    assert!(rested, "process {pid} does not rest");
    seen.expect("it was taken")
}

/// Descriptors by kind. A descriptor that closes meanwhile is not counted.
fn descriptors(pid: u32) -> BTreeMap<String, usize> {
    let mut kinds = BTreeMap::new();
    let Ok(entries) = fs::read_dir(format!("/proc/{pid}/fd")) else {
        return kinds;
    };
    for entry in entries.flatten() {
        if let Ok(target) = fs::read_link(entry.path()) {
            *kinds.entry(kind(&target.to_string_lossy())).or_insert(0) += 1;
        }
    }
    kinds
}

/// `socket:[4711]` is a `socket`, `/memfd:sm2-segment (deleted)` a `memfd:sm2-segment`.
fn kind(target: &str) -> String {
    let name = target.split(":[").next().unwrap_or(target);
    let name = name.trim_end_matches(" (deleted)");
    name.strip_prefix('/').unwrap_or(name).to_owned()
}

/// The state of a thread. It has not run between two equal states of sleep.
#[derive(PartialEq, Eq)]
struct Thread {
    is_asleep: bool,
    /// How often it has left a processor: the lines of its own accord and against it.
    switches: Vec<String>,
}

/// The threads of a process, by their numbers.
fn threads(pid: u32) -> BTreeMap<OsString, Thread> {
    let entries = fs::read_dir(format!("/proc/{pid}/task"))
        .into_iter()
        .flatten()
        .flatten();
    let thread = |entry: fs::DirEntry| {
        let status = fs::read_to_string(entry.path().join("status")).ok()?;
        let is_asleep = status.lines().any(|line| line.starts_with("State:\tS"));
        let switches = status.lines().filter(|line| line.contains("ctxt_switches"));
        let switches = switches.map(str::to_owned).collect();
        Some((
            entry.file_name(),
            Thread {
                is_asleep,
                switches,
            },
        ))
    };
    entries.filter_map(thread).collect()
}

/// The private memory of a process that is in use, in KiB: neither files nor shared memory.
#[must_use]
pub fn anonymous_kib(pid: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let mut lines = status.lines();
    let line = lines.find_map(|line| line.strip_prefix("RssAnon:"))?;
    line.split_whitespace().next()?.parse().ok()
}

fn mappings(pid: u32) -> usize {
    permissions(pid).len()
}

/// The permissions of each mapping of a memory file of SM2 or its tests, but for a node's own
/// counters and for rings: `r--s`, …
#[must_use]
pub fn permissions(pid: u32) -> Vec<String> {
    let ours = maps(pid).filter(|line| !line.contains(COUNTERS) && !line.contains(RING));
    let second = ours.filter_map(|line| line.split_whitespace().nth(1).map(str::to_owned));
    second.collect()
}

/// A line for each mapping of a memory file of SM2 or its tests.
fn maps(pid: u32) -> impl Iterator<Item = String> {
    let maps = fs::read_to_string(format!("/proc/{pid}/maps")).unwrap_or_default();
    let ours: Vec<_> = maps
        .lines()
        .filter(|line| line.contains("memfd:sm2"))
        .map(str::to_owned)
        .collect();
    ours.into_iter()
}
