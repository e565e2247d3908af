//! The machine of a run.

use std::{collections::BTreeMap, fs, thread};

use serde::{Deserialize, Serialize};

/// The machine, and the versions of what ran on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// The name of the processor.
    pub processor: String,
    /// The number of cores that this process may use.
    pub cores: usize,
    /// The size of the memory, in GB.
    pub memory_gb: u64,
    /// The release of the kernel.
    pub kernel: String,
    /// The load of the last minute before the run. Above 0, other programs used the machine, too.
    pub load: f64,
    /// The versions of the peers.
    pub versions: BTreeMap<String, String>,
}

impl Machine {
    /// Describes this machine.
    #[must_use]
    pub fn here() -> Self {
        let read = |path| fs::read_to_string(path).unwrap_or_default();
        let field = |text: &str, name: &str| {
            let line = text.lines().find(|line| line.starts_with(name))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        };
        let memory = field(&read("/proc/meminfo"), "MemTotal").unwrap_or_default();
        let kib = memory.split(' ').next().and_then(|kib| kib.parse().ok());
        let load = read("/proc/loadavg");
        let load = load.split(' ').next().and_then(|load| load.parse().ok());
        Self {
            processor: field(&read("/proc/cpuinfo"), "model name").unwrap_or_default(),
            cores: thread::available_parallelism().map_or(1, usize::from),
            memory_gb: kib.unwrap_or(0_u64) * 1_024 / 1_000_000_000,
            kernel: read("/proc/sys/kernel/osrelease").trim().to_owned(),
            load: load.unwrap_or(0.0),
            versions: versions(include_str!("../Cargo.lock")),
        }
    }
}

/// The versions of the peers in a lock file.
fn versions(lock: &str) -> BTreeMap<String, String> {
    let mut versions = BTreeMap::new();
    for package in lock.split("[[package]]") {
        let field = |name| {
            let line = package.lines().find_map(|line| line.strip_prefix(name))?;
            Some(line.trim_matches(['=', ' ', '"']).to_owned())
        };
        if let (Some(name), Some(version)) = (field("name"), field("version"))
            && matches!(
                name.as_str(),
                "iceoryx2" | "rusteron-media-driver" | "sm2-node" | "zenoh"
            )
        {
            versions.insert(name, version);
        }
    }
    versions
}

#[cfg(test)]
mod tests {
    use super::{Machine, versions};

    #[test]
    fn versions_are_those_of_the_lock_file() {
        let lock = "[[package]]\nname = \"zenoh\"\nversion = \"1.2.3\"\n\n\
                    [[package]]\nname = \"zenoh-util\"\nversion = \"9.0.0\"\n";
        let found: Vec<_> = versions(lock).into_iter().collect();
        assert_eq!(found, [("zenoh".to_owned(), "1.2.3".to_owned())]);
    }

    #[test]
    fn this_machine_has_cores_and_a_kernel() {
        let machine = Machine::here();
        assert!(machine.cores > 0 && !machine.kernel.is_empty());
        assert!(machine.versions.contains_key("sm2-node"));
    }
}
