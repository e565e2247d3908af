//! The command line of an actor: names with values.

use std::{collections::HashMap, fmt::Debug, fs, os::fd::RawFd, str::FromStr};

use nix::{
    libc,
    sys::resource::{Resource, setrlimit},
    unistd::close,
};

/// Options by name.
#[derive(Clone, Debug)]
pub struct Options(HashMap<String, String>);

impl Options {
    /// The options of a command line: each is a name and a value.
    #[must_use]
    pub fn parse(mut arguments: impl Iterator<Item = String>) -> Self {
        let mut options = HashMap::new();
        while let Some(name) = arguments.next() {
            let value = arguments.next();
            let value = value.unwrap_or_else(|| panic!("{name} takes a value"));
            options.insert(name, value);
        }
        Self(options)
    }

    /// The value of an option, if it was given.
    #[must_use]
    pub fn get<T: FromStr<Err: Debug>>(&self, name: &str) -> Option<T> {
        let value = self.0.get(name)?;
        Some(value.parse().unwrap_or_else(|_| panic!("{name} {value}")))
    }

    /// All options, with their values.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &str)> {
        self.0.iter().map(|(name, value)| (&**name, &**value))
    }

    /// The value of an option, or the default.
    #[must_use]
    pub fn get_or<T: FromStr<Err: Debug>>(&self, name: &str, default: T) -> T {
        self.get(name).unwrap_or(default)
    }

    /// With `--nofile N`, this process can have no more than N descriptors. It closes the inherited ones apart from its
    /// standard streams, because their number depends on the caller of the tests.
    ///
    /// Must be called before this process opens a descriptor.
    pub fn limit_files(&self) {
        if let Some(files) = self.get("--nofile") {
            for fd in open_descriptors().filter(|fd| *fd > libc::STDERR_FILENO) {
                // The descriptor of the list of descriptors is closed already.
                let _ = close(fd);
            }
            setrlimit(Resource::RLIMIT_NOFILE, files, files).expect("a limit of files");
        }
    }
}

fn open_descriptors() -> impl Iterator<Item = RawFd> {
    let entries = fs::read_dir("/proc/self/fd").expect("the list of descriptors");
    let names = entries.map(|entry| entry.expect("an entry").file_name());
    let numbers = names.filter_map(|name| name.to_str()?.parse().ok());
    numbers.collect::<Vec<RawFd>>().into_iter()
}
