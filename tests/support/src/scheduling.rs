//! How the kernel schedules a thread.

use std::{fs, path::Path};

/// How the kernel schedules a thread, from its `stat` in `/proc`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scheduling {
    /// The nice value, from -20 to 19.
    pub nice: i32,
    /// The number of the policy: 0 is `SCHED_OTHER`, 5 is `SCHED_IDLE`.
    pub policy: u32,
}

impl Scheduling {
    /// That of the calling thread.
    ///
    /// # Panics
    ///
    /// If `/proc` cannot be read.
    #[must_use]
    pub fn of_this_thread() -> Self {
        Self::read(Path::new("/proc/thread-self"))
    }

    /// That of one thread of the calling process.
    ///
    /// # Panics
    ///
    /// If there is no such thread.
    #[must_use]
    pub fn of_own_thread(thread: u32) -> Self {
        Self::read(&Path::new("/proc/self/task").join(thread.to_string()))
    }

    /// That of each thread of a process.
    ///
    /// # Panics
    ///
    /// If there is no such process, or if one of its threads ends meanwhile.
    #[must_use]
    pub fn of_process(pid: u32) -> Vec<Self> {
        let threads = fs::read_dir(format!("/proc/{pid}/task")).expect("the process");
        let thread = |it: std::io::Result<fs::DirEntry>| Self::read(&it.expect("a thread").path());
        threads.map(thread).collect()
    }

    fn read(folder: &Path) -> Self {
        let stat = fs::read_to_string(folder.join("stat")).expect("the thread");
        // The name in parentheses may contain anything. The first field after it is number 3.
        let (_, fields) = stat.rsplit_once(')').expect("a name");
        let fields: Vec<&str> = fields.split_whitespace().collect();
        Self {
            nice: fields[19 - 3].parse().expect("a number"),
            policy: fields[41 - 3].parse().expect("a number"),
        }
    }
}
