//! Waiting for room on a disk that is full to its last byte.
//!
//! Others may fill a disk below the reserve of the recorder. A black box then tries again until there is room, and
//! removes the oldest files of its ring meanwhile. New messages become gaps. Any other recording ends with the error.

use std::io;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use crate::folder::Folder;
use crate::queue::Queue;
use crate::storage::{Storage, SyncWork, is_full};

/// How often the disk is tried.
const RETRY: Duration = Duration::from_millis(100);

/// Waits for room.
#[derive(Clone)]
pub(super) struct Room {
    pub(super) queue: Arc<Queue>,
    /// The folder, unless there is one file only.
    pub(super) folder: Option<Folder>,
}

impl Room {
    /// The file, whose writes wait for room.
    pub(super) fn file(&self, file: Box<dyn Storage>) -> Box<dyn Storage> {
        let room = self.clone();
        Box::new(WaitingFile { file, room })
    }

    /// Repeats `work` until the disk has room for it.
    pub(super) fn run<T>(&self, mut work: impl FnMut() -> io::Result<T>) -> io::Result<T> {
        let mut done = work();
        if !self.is_to_wait(&done) {
            return done;
        }
        self.queue.set_stuck(true);
        while self.is_to_wait(&done) {
            if !self.remove_oldest() {
                thread::sleep(RETRY);
            }
            done = work();
        }
        self.queue.set_stuck(false);
        done
    }

    fn is_to_wait<T>(&self, done: &io::Result<T>) -> bool {
        matches!(done, Err(error) if is_full(error)) && self.queue.may_be_stuck()
    }

    /// Removes the oldest file of a ring. Returns whether there was one.
    fn remove_oldest(&self) -> bool {
        let ring = self.folder.as_ref().filter(|it| it.is_ring());
        ring.is_some_and(|it| it.remove_oldest().unwrap_or(false))
    }
}

/// A file whose writes wait for room.
struct WaitingFile {
    file: Box<dyn Storage>,
    room: Room,
}

impl Storage for WaitingFile {
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        let Self { file, room } = self;
        room.run(|| file.write_at(bytes, offset))
    }

    fn write_blocks_at(&mut self, blocks: &[u8], offset: u64) -> io::Result<()> {
        let Self { file, room } = self;
        room.run(|| file.write_blocks_at(blocks, offset))
    }

    fn sync(&mut self) -> io::Result<()> {
        let Self { file, room } = self;
        room.run(|| file.sync())
    }

    fn begin_sync(&mut self) -> io::Result<Option<SyncWork>> {
        let Some(work) = self.file.begin_sync()? else {
            return Ok(None);
        };
        let room = self.room.clone();
        Ok(Some(Box::new(move || {
            let done = work();
            // The next interval tries again.
            match room.is_to_wait(&done) {
                true => Ok(()),
                false => done,
            }
        })))
    }

    fn free_bytes(&self) -> io::Result<Option<u64>> {
        self.file.free_bytes()
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::os::fd::AsFd;
    use std::sync::Mutex;

    use nix::errno::Errno;
    use sm2_manager::Background;
    use sm2_node::{Node, Publisher, Shutdown};
    use sm2_test_support::until;

    use super::super::{Options, Recorder, Topics};
    use super::*;
    use crate::bag::Bag;
    use crate::gap::GapReason;
    use crate::verify::check;

    /// A file on a disk that others fill. The errors of writing and synchronizing.
    struct Filled {
        file: File,
        errors: Arc<Mutex<[Option<Errno>; 2]>>,
    }

    impl Filled {
        fn fails(&self, at: usize) -> io::Result<()> {
            self.errors.lock().unwrap()[at].map_or(Ok(()), |it| Err(it.into()))
        }
    }

    impl Storage for Filled {
        fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
            // A full disk takes a part.
            if self.fails(0).is_err() {
                Storage::write_at(&mut self.file, &bytes[..bytes.len() / 2], offset)?;
            }
            self.fails(0)?;
            Storage::write_at(&mut self.file, bytes, offset)
        }

        fn sync(&mut self) -> io::Result<()> {
            self.fails(1)?;
            self.file.sync()
        }

        fn begin_sync(&mut self) -> io::Result<Option<SyncWork>> {
            let error = self.fails(1);
            Ok(Some(Box::new(move || error)))
        }
    }

    /// A domain with a recorder of `data`, which waits for room.
    struct Fixture<'a> {
        _manager: Background,
        folder: tempfile::TempDir,
        data: Publisher<[u8]>,
        recorder: Recorder<'a>,
        errors: Arc<Mutex<[Option<Errno>; 2]>>,
        published: u64,
    }

    impl<'a> Fixture<'a> {
        fn new(stop: &'a Shutdown, waits: bool) -> Self {
            let folder = tempfile::tempdir().unwrap();
            let socket = folder.path().join("sock");
            let manager = Background::start(&socket, sm2_manager::Options::default()).unwrap();
            let connect = |name: &str| Node::builder(name).socket(&socket).connect().unwrap();
            let node = connect("recorder");
            let file = File::create_new(folder.path().join("bag")).unwrap();
            let errors = Arc::<Mutex<[Option<Errno>; 2]>>::default();
            let disk = Filled {
                file,
                errors: Arc::clone(&errors),
            };
            let options = Options {
                sync_interval: Duration::from_millis(1),
                ..Options::new(Topics::All)
            };
            let mut recorder = Recorder::start(&node, disk, options, stop.as_fd()).unwrap();
            if waits {
                recorder.wait_for_room();
            }
            let data = connect("talker").publisher("data").unwrap();
            until("the recorder is linked", || {
                recorder.step(Duration::from_millis(1)).unwrap();
                data.links().iter().any(|it| it.open)
            });
            Self {
                _manager: manager,
                folder,
                data,
                recorder,
                errors,
                published: 0,
            }
        }

        /// Publishes short and long messages until `done`.
        fn publish_until(&mut self, what: &str, done: impl Fn(&Recorder<'_>) -> bool) {
            until(what, || {
                let len = [10, 70_000][self.published as usize % 2];
                self.data.publish(&vec![1; len]).unwrap();
                self.published += 1;
                self.recorder.step(Duration::from_millis(1)).unwrap();
                done(&self.recorder)
            });
        }

        fn fail(&self, at: usize, error: Errno) {
            self.errors.lock().unwrap()[at] = Some(error);
        }
    }

    #[test]
    fn a_disk_that_others_fill_costs_messages_until_it_has_room() {
        for (at, error) in [
            (0, Errno::ENOSPC),
            (0, Errno::EDQUOT),
            (0, Errno::EFBIG),
            (1, Errno::ENOSPC),
        ] {
            let stop = Shutdown::new().unwrap();
            let mut it = Fixture::new(&stop, true);
            it.publish_until("a message is written", |it| it.progress().messages > 0);
            it.fail(at, error);
            let is_short = |it: &Recorder<'_>| it.progress().is_disk_full && it.progress().lost > 3;
            if at == 0 {
                it.publish_until("messages are dropped", is_short);
            } else {
                // A file that cannot be synchronized takes messages.
                let before = it.recorder.progress().messages;
                it.publish_until("more is written", |it| it.progress().messages > before + 10);
            }
            it.errors.lock().unwrap()[at] = None;
            let before = it.recorder.progress().messages;
            it.publish_until("there is room again", |it| {
                let progress = it.progress();
                !progress.is_disk_full && progress.messages > before + 10
            });
            let published = it.published;
            let count = |it: &mut Fixture<'_>| {
                it.recorder.step(Duration::from_millis(1)).unwrap();
                it.recorder.progress().messages + it.recorder.progress().lost
            };
            until("everything is counted", || count(&mut it) == published);
            let report = it.recorder.finish().unwrap();
            let topic = &report.topics[0];
            assert_eq!(topic.messages + topic.lost, published, "{error}");
            assert_eq!(topic.lost > 0, at == 0, "{error}");
            let is_full = |it: &crate::Gap| it.reason == GapReason::DiskFull;
            assert!(topic.gaps.iter().all(is_full), "{topic:?}");
            let bag = Bag::open(&it.folder.path().join("bag")).unwrap();
            assert_eq!(bag.report(), report);
            assert_eq!(check(bag.path()).unwrap().damages, []);
        }
    }

    /// A black box that ends does not wait any more.
    #[test]
    fn the_end_of_a_recording_does_not_wait_for_room() {
        let stop = Shutdown::new().unwrap();
        let mut it = Fixture::new(&stop, true);
        let path = it.folder.path().join("bag");
        let has_messages = |it: Bag| it.report().topics.iter().any(|it| it.messages > 0);
        it.publish_until("a message can be read", |_| {
            Bag::open(&path).is_ok_and(has_messages)
        });
        it.fail(0, Errno::ENOSPC);
        it.publish_until("messages are dropped", |it| it.progress().lost > 3);
        assert!(it.recorder.finish().is_err());
        assert!(has_messages(Bag::open(&path).unwrap()));
    }

    #[test]
    fn a_recording_that_does_not_wait_ends() {
        let stop = Shutdown::new().unwrap();
        let mut it = Fixture::new(&stop, false);
        it.fail(0, Errno::ENOSPC);
        let mut failed = None;
        until("the recording fails", || {
            it.data.publish(&[1; 100]).unwrap();
            failed = it.recorder.step(Duration::from_millis(1)).err();
            failed.is_some()
        });
        let failed = failed.unwrap().to_string();
        assert!(failed.contains("No space left on device"), "{failed}");
    }
}
