//! Disks that are slow, full or broken.

use std::fs::File;
use std::io;
use std::os::fd::AsFd;
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use nix::errno::Errno;
use sm2_bag::{
    Bag, Filter, GapReason, Options, RecordError, Recorder, Storage, SyncWork, WriteError, check,
    recover,
};
use sm2_node::{Name, Shutdown};

use crate::common::{Domain, named, record, until};

/// A file whose writes wait while the gate is closed, and fail beyond a limit.
pub(crate) struct Disk {
    file: File,
    gate: Arc<Gate>,
    /// How many bytes can be written, and how often the file can be synchronized.
    left: (usize, usize),
    /// The error beyond that.
    error: Errno,
}

#[derive(Default)]
pub(crate) struct Gate {
    is_closed: Mutex<bool>,
    changed: Condvar,
}

impl Gate {
    pub(crate) fn set(&self, is_closed: bool) {
        *self.is_closed.lock().unwrap() = is_closed;
        self.changed.notify_all();
    }

    fn pass(&self) {
        let is_closed = self.is_closed.lock().unwrap();
        drop(self.changed.wait_while(is_closed, |it| *it).unwrap());
    }
}

impl Storage for Disk {
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.gate.pass();
        let left = self.left.0.checked_sub(bytes.len());
        self.left.0 = left.ok_or(self.error)?;
        Storage::write_at(&mut self.file, bytes, offset)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.gate.pass();
        self.left.1 = self.left.1.checked_sub(1).ok_or(self.error)?;
        self.file.sync()
    }
}

impl Disk {
    /// A disk that takes everything while its gate is open.
    pub(crate) fn with_gate(domain: &Domain, name: &str) -> (Self, Arc<Gate>) {
        let gate = Arc::new(Gate::default());
        let disk = Self {
            file: domain.create(name),
            gate: Arc::clone(&gate),
            left: (usize::MAX, usize::MAX),
            error: Errno::ENOSPC,
        };
        (disk, gate)
    }
}

#[test]
fn a_frozen_disk_costs_messages_that_are_counted_and_nobody_waits() {
    let domain = Domain::new();
    let data = domain.node("talker").publisher::<[u8]>("data").unwrap();
    let node = domain.node("recorder");
    let (disk, gate) = Disk::with_gate(&domain, "bag");
    let options = Options {
        budget_bytes: 50_000,
        ..Options::new(named(&["data"]))
    };
    let mut number = 0;
    let report = record(&node, disk, options, |record_until| {
        record_until(&mut |_| data.links().iter().any(|it| it.open));
        data.publish(&[0; 1_000]).unwrap();
        record_until(&mut |it| it.progress().messages == 1);
        gate.set(true);
        // The writer stops at the end of its interval at the latest.
        let mut lost = 0;
        while lost < 20 {
            number += 1;
            data.publish(&[number as u8; 1_000]).unwrap();
            record_until(&mut |it| {
                let progress = it.progress();
                assert!(progress.waiting_bytes <= 50_000);
                lost = progress.lost;
                progress.messages + progress.lost + progress.waiting_bytes / 1_000 > number
            });
        }
        gate.set(false);
        record_until(&mut |it| it.progress().waiting_bytes == 0);
        data.publish(&[7; 1_000]).unwrap();
        record_until(&mut |it| it.progress().messages + it.progress().lost == number + 2);
    });
    let topic = &report.topics[0];
    assert_eq!(topic.messages + topic.lost, number + 2);
    assert!(topic.lost > 0);
    let reasons: Vec<_> = topic.gaps.iter().map(|it| it.reason).collect();
    assert_eq!(reasons, [GapReason::Budget]);
    let bag = Bag::open(&domain.path("bag")).unwrap();
    assert_eq!(bag.report(), report);
    assert_eq!(check(bag.path()).unwrap().damages, []);
}

/// A file whose writes pass while a synchronization waits at the gate.
struct SlowToSync(File, Arc<Gate>);

impl Storage for SlowToSync {
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        Storage::write_at(&mut self.0, bytes, offset)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.1.pass();
        self.0.sync()
    }

    fn begin_sync(&mut self) -> io::Result<Option<SyncWork>> {
        let gate = Arc::clone(&self.1);
        Ok(Some(Box::new(move || {
            gate.pass();
            Ok(())
        })))
    }
}

/// Only few of them wait in the slots of the publisher. The budget is the limit.
#[test]
fn a_disk_that_stalls_costs_no_long_message_within_the_budget() {
    let domain = Domain::new();
    let (disk, gate) = Disk::with_gate(&domain, "bag");
    stall(&domain, disk, &gate);
    let (domain, gate) = (Domain::new(), Arc::default());
    let disk = SlowToSync(domain.create("bag"), Arc::clone(&gate));
    stall(&domain, disk, &gate);
}

/// Publishes 30 long messages while the gate of the disk is closed. The budget has room for 40.
fn stall(domain: &Domain, disk: impl Storage + 'static, gate: &Gate) {
    const LEN: usize = 100_000;
    let data = domain.node("talker").publisher::<[u8]>("data").unwrap();
    let node = domain.node("recorder");
    let options = Options {
        budget_bytes: 40 * LEN as u64,
        sync_interval: Duration::from_millis(1),
        ..Options::new(named(&["data"]))
    };
    let report = record(&node, disk, options, |record_until| {
        record_until(&mut |_| data.links().iter().any(|it| it.open));
        gate.set(true);
        for number in 0..30 {
            data.publish(&vec![number; LEN]).unwrap();
            record_until(&mut |it| {
                let waiting = it.progress().waiting_bytes / LEN as u64;
                it.progress().messages + waiting > u64::from(number)
            });
        }
        assert!(data.counters().dropped() == 0);
        gate.set(false);
        record_until(&mut |it| it.progress().messages == 30);
    });
    let topic = &report.topics[0];
    assert_eq!((topic.messages, topic.lost), (30, 0), "{topic:?}");
    let bag = Bag::open(&domain.path("bag")).unwrap();
    for (number, message) in (0..30).zip(bag.messages(&Filter::default())) {
        assert!(message.unwrap().data == vec![number; LEN], "{number}");
    }
    assert_eq!(check(bag.path()).unwrap().damages, []);
}

#[test]
fn the_publisher_of_a_reliable_topic_waits_for_a_frozen_disk() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let node = domain.node("recorder");
    // Many short messages fill the memory; a few long ones fill the slots that may wait.
    for (name, len) in [("short", 1_000), ("long", 100_000)] {
        let data = talker.publisher_builder::<[u8]>(name);
        let data = data.reliable(true).declare().unwrap();
        let (disk, gate) = Disk::with_gate(&domain, &format!("{name}.mcap"));
        let options = Options {
            budget_bytes: 50_000,
            reliable: [Name::new(name).unwrap()].into(),
            ..Options::new(named(&[name]))
        };
        let mut sent = 0;
        let report = record(&node, disk, options, |record_until| {
            record_until(&mut |_| data.links().iter().any(|it| it.open));
            gate.set(true);
            let mut refused = 0;
            while refused < 20 {
                match data.try_publish(&vec![0; len]).unwrap() {
                    Some(_) => (sent, refused) = (sent + 1, 0),
                    None => refused += 1,
                }
                let mut is_over = false;
                record_until(&mut |it| {
                    assert!(it.progress().waiting_bytes <= 50_000 + len as u64);
                    std::mem::replace(&mut is_over, true)
                });
            }
            gate.set(false);
            record_until(&mut |it| it.progress().messages == sent);
        });
        let topic = &report.topics[0];
        assert!(sent > 1, "{name}: {sent}");
        assert_eq!((topic.messages, topic.lost), (sent, 0), "{name}");
    }
}

#[test]
fn a_disk_that_fails_ends_the_recording_and_what_was_written_can_be_read() {
    for (bytes, syncs, error) in [
        (20_000, usize::MAX, Errno::ENOSPC),
        (20_000, usize::MAX, Errno::EIO),
        (usize::MAX, 5, Errno::EIO),
    ] {
        fail(bytes, syncs, error);
    }
}

/// Records to a disk that fails after some bytes and synchronizations.
fn fail(bytes: usize, syncs: usize, expected: Errno) {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let data = talker.publisher::<[u8]>("data").unwrap();
    let node = domain.node("recorder");
    let disk = Disk {
        file: domain.create("bag"),
        gate: Arc::default(),
        left: (bytes, syncs),
        error: expected,
    };
    let shutdown = Shutdown::new().unwrap();
    let options = Options {
        sync_interval: Duration::from_millis(1),
        ..Options::new(named(&["data"]))
    };
    let mut recorder = Recorder::start(&node, disk, options, shutdown.as_fd()).unwrap();
    let mut failed = None;
    until("the recording fails", || {
        data.publish(&[1; 1_000]).unwrap();
        failed = recorder.step(Duration::from_millis(5)).err();
        failed.is_some()
    });
    let Some(RecordError::Write(WriteError::Io(error))) = failed else {
        panic!("{failed:?}");
    };
    assert_eq!(error.raw_os_error(), Some(expected as i32));
    assert!(recorder.finish().is_err());
    let bag = Bag::open(&domain.path("bag")).unwrap();
    let report = bag.report();
    assert!(!report.complete && report.topics[0].messages > 0);
    let recovered = recover(bag.path(), &domain.path("whole")).unwrap();
    assert!(recovered.complete);
    assert_eq!(recovered.topics, report.topics);
    assert_eq!(check(&domain.path("whole")).unwrap().damages, []);
}

/// A disk that fails while the recorder goes on writing: the recording ends with the error.
#[test]
fn a_disk_that_fails_to_synchronize_ends_the_recording() {
    struct Failing(File);

    impl Storage for Failing {
        fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
            Storage::write_at(&mut self.0, bytes, offset)
        }

        fn sync(&mut self) -> io::Result<()> {
            self.0.sync()
        }

        fn begin_sync(&mut self) -> io::Result<Option<SyncWork>> {
            Ok(Some(Box::new(|| Err(Errno::EIO.into()))))
        }
    }

    let domain = Domain::new();
    let data = domain.node("talker").publisher::<[u8]>("data").unwrap();
    let shutdown = Shutdown::new().unwrap();
    let options = Options {
        sync_interval: Duration::from_millis(1),
        ..Options::new(named(&["data"]))
    };
    let disk = Failing(domain.create("bag"));
    let node = domain.node("recorder");
    let mut recorder = Recorder::start(&node, disk, options, shutdown.as_fd()).unwrap();
    // One message only: the interval after it tells.
    let mut is_sent = false;
    let mut failed = None;
    until("the recording fails", || {
        failed = recorder.step(Duration::from_millis(5)).err();
        if !is_sent && data.links().iter().any(|it| it.open) {
            data.publish(&[1]).unwrap();
            is_sent = true;
        }
        failed.is_some()
    });
    let Some(RecordError::Write(WriteError::Io(error))) = failed else {
        panic!("{failed:?}");
    };
    assert_eq!(error.raw_os_error(), Some(Errno::EIO as i32));
    assert!(is_sent);
}
