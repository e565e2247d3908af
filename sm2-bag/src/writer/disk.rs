//! The thread that uses the file: the disk is busy while the next message is prepared.

use std::io;
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;

use sm2_node::Sample;

use super::syncing::{Synced, Syncing};
use crate::storage::Storage;

/// How many operations may wait: those of two long messages.
const WAITING_MAX: usize = 4;

/// Runs when a long message is in the file and its slot is free.
pub(crate) type Done = Box<dyn FnOnce() + Send>;

/// The file. A thread of its own carries out the operations in their order.
///
/// A later call returns the error of an operation. After an error, nothing more is written. A value that is dropped
/// waits for its operations.
pub(super) struct Disk {
    /// `None` only while the value is dropped.
    operations: Option<SyncSender<Operation>>,
    /// `None` after its error was returned.
    thread: Option<JoinHandle<io::Result<()>>>,
    /// The result of the synchronization that was begun.
    synced: Option<Receiver<io::Result<()>>>,
}

enum Operation {
    Write { bytes: Vec<u8>, offset: u64 },
    WriteMessage(MessageWrite),
    BeginSync(Synced),
    Sync(Answer<()>),
    FreeBytes(Answer<Option<u64>>),
}

type Answer<T> = SyncSender<T>;

/// Writes the first bytes of a message from its slot.
pub(super) struct MessageWrite {
    pub(super) message: Sample<[u8]>,
    pub(super) len_bytes: usize,
    pub(super) offset: u64,
    /// Whether the bytes are whole blocks, aligned in memory and in the file.
    pub(super) has_whole_blocks: bool,
    pub(super) done: Done,
}

impl Disk {
    pub(super) fn start(storage: Box<dyn Storage>) -> io::Result<Self> {
        let (operations, to_do) = sync_channel(WAITING_MAX);
        let thread =
            sm2_io::spawn_without_signals("sm2-bag-disk".to_owned(), move || run(storage, &to_do))?;
        Ok(Self {
            operations: Some(operations),
            thread: Some(thread),
            synced: None,
        })
    }

    pub(super) fn write(&mut self, bytes: Vec<u8>, offset: u64) -> io::Result<()> {
        self.begin(Operation::Write { bytes, offset })
    }

    pub(super) fn write_message(&mut self, write: MessageWrite) -> io::Result<()> {
        self.begin(Operation::WriteMessage(write))
    }

    /// Begins to write everything to the disk that was written to the file before, when that of the last time is done.
    pub(super) fn begin_sync(&mut self) -> io::Result<()> {
        self.end_sync()?;
        let (synced, result) = channel();
        self.synced = Some(result);
        self.begin(Operation::BeginSync(synced))
    }

    /// Waits until everything is on the disk that was written before [`begin_sync`](Self::begin_sync).
    pub(super) fn end_sync(&mut self) -> io::Result<()> {
        match self.synced.take().map(|it| it.recv()) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(_)) => Err(self.error()),
        }
    }

    /// Writes everything to the disk.
    pub(super) fn sync(&mut self) -> io::Result<()> {
        self.end_sync()?;
        self.ask(Operation::Sync)
    }

    pub(super) fn free_bytes(&mut self) -> io::Result<Option<u64>> {
        self.ask(Operation::FreeBytes)
    }

    fn ask<T>(&mut self, operation: impl FnOnce(Answer<T>) -> Operation) -> io::Result<T> {
        let (answer, answers) = sync_channel(1);
        self.begin(operation(answer))?;
        answers.recv().map_err(|_| self.error())
    }

    fn begin(&mut self, operation: Operation) -> io::Result<()> {
        match &self.operations {
            Some(operations) if operations.send(operation).is_ok() => Ok(()),
            _ => Err(self.error()),
        }
    }

    /// The error that has ended the thread.
    fn error(&mut self) -> io::Error {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(Err(error))) => error,
            _ => io::Error::other("the thread that writes the file has ended"),
        }
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        self.operations = None;
        if let Some(thread) = self.thread.take() {
            // Nobody waits for the error of an operation whose recording has failed, or is complete.
            let _ = thread.join();
        }
    }
}

/// Carries out the operations until the first error.
fn run(mut storage: Box<dyn Storage>, operations: &Receiver<Operation>) -> io::Result<()> {
    let mut syncing = Syncing::default();
    for operation in operations {
        match operation {
            Operation::Write { bytes, offset } => storage.write_at(&bytes, offset)?,
            Operation::WriteMessage(write) => write.carry_out(&mut *storage)?,
            Operation::BeginSync(synced) => match storage.begin_sync()? {
                Some(work) => syncing.begin(work, synced)?,
                None => {
                    storage.sync()?;
                    let _ = synced.send(Ok(()));
                }
            },
            Operation::Sync(answer) => {
                storage.sync()?;
                let _ = answer.send(());
            }
            Operation::FreeBytes(answer) => {
                let _ = answer.send(storage.free_bytes()?);
            }
        }
    }
    Ok(())
}

impl MessageWrite {
    fn carry_out(self, storage: &mut dyn Storage) -> io::Result<()> {
        let bytes = &self.message[..self.len_bytes];
        match self.has_whole_blocks {
            true => storage.write_blocks_at(bytes, self.offset)?,
            false => storage.write_at(bytes, self.offset)?,
        }
        drop(self.message);
        (self.done)();
        Ok(())
    }
}
