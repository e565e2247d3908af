//! A domain, and recordings of it.
#![allow(dead_code, reason = "each test uses its own part")]

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::ops::Range;
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use mcap::MAGIC;
use mcap::records::op;
use sm2_bag::{Compression, Options, Recorder, Report, Storage, Topics};
use sm2_manager::Background;
use sm2_node::{Name, Node, Shutdown};
use sm2_test_support::memory;
pub(crate) use sm2_test_support::{SOON, until};

pub(crate) struct Domain {
    _manager: Background,
    pub(crate) folder: tempfile::TempDir,
}

impl Domain {
    pub(crate) fn new() -> Self {
        Self::with(sm2_manager::Options::default())
    }

    /// With this Manager.
    pub(crate) fn with(options: sm2_manager::Options) -> Self {
        let folder = memory_folder();
        Self {
            _manager: Background::start(&folder.path().join("sock"), options).unwrap(),
            folder,
        }
    }

    pub(crate) fn node(&self, name: &str) -> Node {
        let socket = self.folder.path().join("sock");
        Node::builder(name).socket(socket).connect().unwrap()
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A new bag.
    pub(crate) fn create(&self, name: &str) -> File {
        File::create_new(self.path(name)).unwrap()
    }
}

/// A folder in memory where the system has room for it.
pub(crate) fn memory_folder() -> tempfile::TempDir {
    tempfile::tempdir_in(memory()).unwrap()
}

/// These topics.
pub(crate) fn named(names: &[&str]) -> Topics {
    let names: BTreeSet<_> = names.iter().map(|it| Name::new(it).unwrap()).collect();
    Topics::Named(names)
}

/// Records until a condition holds.
pub(crate) type RecordUntil<'a> = dyn FnMut(&mut dyn FnMut(&Recorder<'_>) -> bool) + 'a;

/// Records while `publish` runs, which gets a function that records until its condition holds.
pub(crate) fn record(
    node: &Node,
    storage: impl Storage + 'static,
    options: Options,
    publish: impl FnOnce(&mut RecordUntil<'_>),
) -> Report {
    let shutdown = Shutdown::new().unwrap();
    let mut recorder = Recorder::start(node, storage, options, shutdown.as_fd()).unwrap();
    publish(&mut |done| {
        let until = Instant::now() + SOON;
        while !done(&recorder) {
            assert!(
                Instant::now() < until,
                "not in time: {:?}",
                recorder.progress()
            );
            recorder.step(Duration::from_millis(5)).unwrap();
        }
    });
    recorder.finish().unwrap()
}

/// The places of the records with this opcode, outside of chunks, in a file that may still be written.
pub(crate) fn places(bytes: &[u8], opcode: u8) -> Vec<Range<usize>> {
    let mut places = Vec::new();
    let mut at = MAGIC.len();
    while let Some(&[its, ref len @ ..]) = bytes.get(at..at + 9) {
        let end = at + 9 + u64::from_le_bytes(len.try_into().unwrap()) as usize;
        if end > bytes.len() {
            break;
        }
        if its == opcode {
            places.push(at..end);
        }
        at = end;
    }
    places
}

/// A bag of the numbers from 0 on, with a chunk for each message.
pub(crate) fn chunked(compression: Compression, messages: u64) -> Vec<u8> {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let numbers = talker.publisher::<u64>("numbers").unwrap();
    let node = domain.node("recorder");
    let options = Options {
        compression,
        sync_interval: Duration::from_millis(1),
        ..Options::new(named(&["numbers"]))
    };
    let file = domain.path("bag");
    record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| numbers.links().iter().any(|it| it.open));
        for number in 0..messages {
            numbers.publish(&number).unwrap();
            // Its chunk has ended.
            let chunks = || places(&fs::read(&file).unwrap(), op::CHUNK).len() as u64;
            record_until(&mut |_| chunks() > number);
        }
    });
    fs::read(&file).unwrap()
}

/// A small attachment.
pub(crate) fn picture() -> mcap::Attachment<'static> {
    mcap::Attachment {
        log_time: 7,
        create_time: 8,
        name: "map.png".to_owned(),
        media_type: "image/png".to_owned(),
        data: b"a picture".as_slice().into(),
    }
}
