//! The thread that uses the file: the disk is busy while the next message is prepared.
//!
//! Each byte of a message is read once. A publisher can still write to a pooled slot, and a checksum of other bytes
//! than those in the file would ruin the bag of all topics. A long message is therefore copied into one of three
//! private buffers of 8 MiB, and the checksum is computed over the copy, part by part while it is in the cache. Without
//! a checksum (0 in MCAP), the disk could read the slots, but nothing would find a payload that a power cut has torn.
//! The buffers are in huge pages: with small ones, the disk took more requests and wrote half as fast. Five recordings
//! of 1 GB in messages of 10 MiB alternated with five of a recorder that let the disk read the slots: 348 MB/s
//! (320-413) instead of 364 MB/s (319-385), and 0.38 s of processor time instead of 0.25 s.

use std::io;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;

use crc32fast::Hasher;
use sm2_io::{Segment, Slot};

use super::syncing::{Synced, Syncing};
use crate::storage::{BLOCK_BYTES, Storage};

/// How many operations may wait.
const WAITING_MAX: usize = 4;
/// The length of a buffer for blocks, in bytes. The disk is not faster with longer ones.
const BUFFER_BYTES: usize = 8 << 20;
const _: () = assert!(BUFFER_BYTES.is_multiple_of(BLOCK_BYTES));
/// One buffer is on its way to the disk, another one waits, and a third one is being filled.
const BUFFERS: usize = 3;
/// So many bytes are copied at a time, so that the checksum reads them from the cache.
const PART_BYTES: usize = 64 << 10;

/// Runs when the blocks of a long message are in the file.
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
    /// The buffers that hold nothing, and how many there are in all.
    free: Receiver<Buffer>,
    buffers: usize,
}

enum Operation {
    Write {
        bytes: Vec<u8>,
        offset: u64,
    },
    /// Writes the first `len_bytes` of a buffer, which are whole blocks.
    WriteBlocks {
        buffer: Buffer,
        len_bytes: usize,
        offset: u64,
    },
    Done(Done),
    BeginSync(Synced),
    Sync(Answer<()>),
    FreeBytes(Answer<Option<u64>>),
}

type Answer<T> = SyncSender<T>;

/// Memory for [`Disk::write_blocks`] that no other process has. It is in huge pages if the system has them: the disk
/// takes fewer requests then.
pub(super) struct Buffer(Slot);

impl Buffer {
    fn new() -> io::Result<Self> {
        let mut segment = Segment::create(BUFFER_BYTES as u64, 1)?;
        segment.prefault()?;
        let (_, slots) = segment.split();
        let slot = slots.into_iter().next();
        slot.map(Self).ok_or(io::ErrorKind::OutOfMemory.into())
    }

    /// Copies as many bytes as have room, and adds the copies to the checksum. Returns their number.
    pub(super) fn fill(&mut self, bytes: &[u8], crc: &mut Hasher) -> usize {
        let len = bytes.len().min(BUFFER_BYTES);
        let copies = self.0.bytes_mut(len).chunks_mut(PART_BYTES);
        for (copy, part) in copies.zip(bytes[..len].chunks(PART_BYTES)) {
            copy.copy_from_slice(part);
            crc.update(copy);
        }
        len
    }
}

impl Disk {
    pub(super) fn start(storage: Box<dyn Storage>) -> io::Result<Self> {
        let (operations, to_do) = sync_channel(WAITING_MAX);
        let (freed, free) = channel();
        let work = move || run(storage, &to_do, &freed);
        let thread = sm2_io::spawn_without_signals("sm2-bag-disk".to_owned(), work)?;
        Ok(Self {
            operations: Some(operations),
            thread: Some(thread),
            synced: None,
            free,
            buffers: 0,
        })
    }

    pub(super) fn write(&mut self, bytes: Vec<u8>, offset: u64) -> io::Result<()> {
        self.begin(Operation::Write { bytes, offset })
    }

    /// Makes a buffer, or waits for one that holds nothing.
    pub(super) fn buffer(&mut self) -> io::Result<Buffer> {
        if let Ok(buffer) = self.free.try_recv() {
            return Ok(buffer);
        }
        if self.buffers < BUFFERS {
            match Buffer::new() {
                Ok(buffer) => {
                    self.buffers += 1;
                    return Ok(buffer);
                }
                Err(error) if self.buffers == 0 => return Err(error),
                // The other buffers serve as well.
                Err(_) => {}
            }
        }
        self.free.recv().map_err(|_| self.error())
    }

    /// Writes the first `len_bytes` of a buffer. They and `offset` are multiples of [`BLOCK_BYTES`].
    pub(super) fn write_blocks(
        &mut self,
        buffer: Buffer,
        len_bytes: usize,
        offset: u64,
    ) -> io::Result<()> {
        self.begin(Operation::WriteBlocks {
            buffer,
            len_bytes,
            offset,
        })
    }

    /// Runs `done` when everything before it is in the file.
    pub(super) fn then(&mut self, done: Done) -> io::Result<()> {
        self.begin(Operation::Done(done))
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
fn run(
    mut storage: Box<dyn Storage>,
    operations: &Receiver<Operation>,
    freed: &Sender<Buffer>,
) -> io::Result<()> {
    let mut syncing = Syncing::default();
    for operation in operations {
        match operation {
            Operation::Write { bytes, offset } => storage.write_at(&bytes, offset)?,
            Operation::WriteBlocks {
                buffer,
                len_bytes,
                offset,
            } => {
                storage.write_blocks_at(buffer.0.bytes(len_bytes), offset)?;
                // Nobody fills a buffer when the recording ends.
                let _ = freed.send(buffer);
            }
            Operation::Done(done) => done(),
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
