//! Files that peers leave in /dev/shm, when they are killed or always.

use std::{collections::HashSet, fs};

const FOLDER: &str = "/dev/shm";

/// The files in /dev/shm before a case.
pub struct Leftovers {
    tag: String,
    before: HashSet<String>,
}

impl Leftovers {
    /// Lists the files before a case. Files whose name starts with `tag` belong to the case.
    #[must_use]
    pub fn before(tag: String) -> Self {
        Self {
            tag,
            before: names().collect(),
        }
    }

    /// Removes the files that the case left: those with its tag, and new ones that have a peer's
    /// kind of name and that no process has mapped. Call this when its processes have ended.
    pub fn remove(&self) {
        let new: Vec<_> = names()
            .filter(|name| !self.before.contains(name))
            .filter(|name| name.starts_with(&self.tag) || is_a_peers(name))
            .collect();
        if new.is_empty() {
            return;
        }
        let mapped = mapped();
        for name in new {
            if name.starts_with(&self.tag) || !mapped.contains(&name) {
                // Another process may have removed the file already.
                let _ = fs::remove_file(format!("{FOLDER}/{name}"));
            }
        }
    }
}

fn names() -> impl Iterator<Item = String> {
    let entries = fs::read_dir(FOLDER).into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().into_string().ok())
}

/// True for names of Zenoh and Fast DDS, whose prefix cannot be configured.
fn is_a_peers(name: &str) -> bool {
    name.ends_with(".zenoh")
        || name.starts_with("fastrtps_")
        || name.starts_with("fast_datasharing_")
        || name.starts_with("sem.fastrtps_")
}

/// The files in /dev/shm that a process has mapped.
fn mapped() -> HashSet<String> {
    let mut mapped = HashSet::new();
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        // Entries that are not processes, or belong to another user, have no readable maps.
        let maps = fs::read_to_string(entry.path().join("maps")).unwrap_or_default();
        for line in maps.lines() {
            if let Some((_, name)) = line.split_once("/dev/shm/") {
                mapped.insert(name.trim_end_matches(" (deleted)").to_owned());
            }
        }
    }
    mapped
}

#[cfg(test)]
mod tests {
    use super::{Leftovers, is_a_peers};
    use std::{fs, path::Path};

    #[test]
    fn only_what_came_later_and_is_a_peers_is_removed() {
        let id = std::process::id();
        let [old, new, foreign] = ["a.zenoh", "b", "c"].map(|name| format!("sm2test{id}{name}"));
        let path = |name: &str| format!("/dev/shm/{name}");
        fs::write(path(&old), "").unwrap();
        let leftovers = Leftovers::before(format!("sm2test{id}b"));
        fs::write(path(&new), "").unwrap();
        fs::write(path(&foreign), "").unwrap();
        leftovers.remove();
        let there = [&old, &new, &foreign].map(|name| Path::new(&path(name)).exists());
        for name in [&old, &foreign] {
            fs::remove_file(path(name)).unwrap();
        }
        assert_eq!(there, [true, false, true]);
    }

    #[test]
    fn names_of_peers_are_known() {
        assert!(is_a_peers("1234567.zenoh") && is_a_peers("fastrtps_5ab"));
        assert!(!is_a_peers("somebody") && !is_a_peers("zenoh.txt"));
    }
}
