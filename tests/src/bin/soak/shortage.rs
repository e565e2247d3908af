//! Shortages: a process gets no further descriptors, or no further addresses for mappings, for a while.

use std::fs;

use rustix::process::{Pid, Resource, Rlimit, prlimit};
use sm2_tests::random::Random;

/// With a shortage of addresses, a process can still map this much in total: its allocator may need some,
/// and a Rust program without memory for it aborts. A mapping of 10 MB fails, and so do several rings.
const HEADROOM_BYTES: u64 = 1 << 20;
/// With a shortage of descriptors, a process can still open fewer than this many.
const FEW: u64 = 4;

/// The resource that a process is short of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Descriptors,
    Addresses,
}

/// A limit of another process, which [`end`](Self::end) sets back.
#[derive(Debug)]
pub(crate) struct Shortage {
    pid: Pid,
    resource: Resource,
    before: Rlimit,
}

impl Shortage {
    /// Begins a shortage of the process. `None` if it has ended.
    pub(crate) fn begin(pid: u32, kind: Kind, random: &mut Random) -> Option<Self> {
        let (resource, limit) = match kind {
            Kind::Descriptors => {
                let open = fs::read_dir(format!("/proc/{pid}/fd")).ok()?.count() as u64;
                (Resource::Nofile, open + random.within(0..FEW))
            }
            Kind::Addresses => (Resource::As, addresses_bytes(pid)? + HEADROOM_BYTES),
        };
        let pid = Pid::from_raw(pid.cast_signed())?;
        let before = rustix::process::getrlimit(resource);
        let new = Rlimit {
            current: Some(limit),
            ..before
        };
        let before = prlimit(Some(pid), resource, new).ok()?;
        Some(Self {
            pid,
            resource,
            before,
        })
    }

    pub(crate) fn end(self) {
        // Fails if the process has just ended.
        let _ = prlimit(Some(self.pid), self.resource, self.before);
    }
}

/// The size of the address space of a process.
fn addresses_bytes(pid: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find_map(|it| it.strip_prefix("VmSize:"))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib << 10)
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use sm2_tests::{process::Process, random::Random};

    use super::{Kind, Shortage};

    fn limit(pid: u32, name: &str) -> String {
        let limits = std::fs::read_to_string(format!("/proc/{pid}/limits")).unwrap();
        let line = limits.lines().find_map(|it| it.strip_prefix(name)).unwrap();
        line.split_whitespace().next().unwrap().to_owned()
    }

    #[test]
    fn a_shortage_changes_one_limit_and_sets_it_back() {
        let mut cat = Process::start(Command::new("cat"));
        cat.say("it runs");
        assert_eq!(cat.expect_line(), "it runs");
        let pid = cat.pid();
        for (kind, name) in [
            (Kind::Descriptors, "Max open files"),
            (Kind::Addresses, "Max address space"),
        ] {
            let before = limit(pid, name);
            let shortage = Shortage::begin(pid, kind, &mut Random::new(1)).unwrap();
            let short: u64 = limit(pid, name).parse().unwrap();
            assert!(short < 1 << 30, "{kind:?}: {short}");
            assert_ne!(limit(pid, name), before, "{kind:?}");
            shortage.end();
            assert_eq!(limit(pid, name), before, "{kind:?}");
        }
    }
}
