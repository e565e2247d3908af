//! The messages that wait for the disk.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use nix::errno::Errno;
use nix::sys::eventfd::{EfdFlags, EventFd};
use sm2_node::Sample;

use crate::clock::ClockRelation;
use crate::error::WriteError;
use crate::gap::Gap;
use crate::source::Source;
use crate::writer::MessageTimes;

/// Work for the thread that writes the file.
#[derive(Debug)]
pub(crate) enum Item {
    Message {
        source: Arc<Source>,
        times: MessageTimes,
        payload: Payload,
    },
    Gap(Arc<Source>, Gap),
    Clock(ClockRelation),
    /// The file ends, with everything up to this time of the wall clock.
    EndFile(u64),
}

/// The payload of a message that waits.
#[derive(Debug)]
pub(crate) enum Payload {
    /// A copy: the slot is free again.
    Copied(Vec<u8>),
    /// The message itself, in the slot of its publisher.
    Held(Sample<[u8]>, HeldBy),
}

/// The topic whose messages are held, by the recorder's number of the topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct HeldBy(pub(crate) usize);

impl Payload {
    pub(crate) fn bytes(&self) -> &[u8] {
        match self {
            Self::Copied(bytes) => bytes,
            Self::Held(sample, _) => sample,
        }
    }
}

/// How far the writer is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Written {
    pub(crate) messages: u64,
    pub(crate) bytes: u64,
}

/// The items between the thread that receives and the thread that writes.
#[derive(Debug)]
pub(crate) struct Queue {
    state: Mutex<State>,
    changed: Condvar,
    /// Readable when a reliable topic that was refused may find room.
    room: Arc<EventFd>,
}

#[derive(Debug, Default)]
struct State {
    items: VecDeque<Item>,
    /// The length of all payloads that were pushed and not written yet, in bytes.
    waiting_bytes: u64,
    /// How many messages of each topic are held.
    held: Vec<usize>,
    written: Written,
    is_closed: bool,
    failed: Option<WriteError>,
    has_failed: bool,
    is_disk_full: bool,
    /// Whether a reliable topic was refused.
    is_refused: bool,
}

impl Queue {
    pub(crate) fn new() -> io::Result<Self> {
        let flags = EfdFlags::EFD_NONBLOCK | EfdFlags::EFD_CLOEXEC;
        Ok(Self {
            state: Mutex::default(),
            changed: Condvar::new(),
            room: Arc::new(EventFd::from_flags(flags)?),
        })
    }

    /// A descriptor that is readable when a topic that was refused may find [room](Self::has_room).
    pub(crate) const fn room(&self) -> &Arc<EventFd> {
        &self.room
    }

    /// Lets the descriptor wait for the next room.
    pub(crate) fn take_room_signal(&self) -> io::Result<()> {
        match self.room.read() {
            Ok(_) | Err(Errno::EAGAIN) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Whether another message of a topic can wait. If not, the descriptor tells when the topic shall try again.
    pub(crate) fn has_room(&self, budget_bytes: u64, held_by: HeldBy, held_max: usize) -> bool {
        let mut state = self.lock();
        let held = state.held.get(held_by.0).copied().unwrap_or_default();
        let has_room = held < held_max && state.waiting_bytes < budget_bytes;
        state.is_refused |= !has_room;
        has_room
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds an item. The writer ends the queue with an error if it fails; then the item is dropped.
    pub(crate) fn push(&self, item: Item) {
        let mut state = self.lock();
        if let Item::Message { payload, .. } = &item {
            state.waiting_bytes += payload.bytes().len() as u64;
            if let Payload::Held(_, HeldBy(topic)) = payload {
                if state.held.len() <= *topic {
                    state.held.resize(topic + 1, 0);
                }
                state.held[*topic] += 1;
            }
        }
        state.items.push_back(item);
        self.changed.notify_one();
    }

    /// The length of the payloads that wait, in bytes.
    pub(crate) fn waiting_bytes(&self) -> u64 {
        self.lock().waiting_bytes
    }

    /// How many messages of a topic are held.
    pub(crate) fn held(&self, HeldBy(topic): HeldBy) -> usize {
        self.lock().held.get(topic).copied().unwrap_or_default()
    }

    pub(crate) fn written(&self) -> Written {
        self.lock().written
    }

    /// Waits for an item for at most `timeout`. The second value is whether more items can come.
    pub(crate) fn pop(&self, timeout: Duration) -> (Option<Item>, bool) {
        let state = self.lock();
        let is_idle = |state: &mut State| state.items.is_empty() && !state.is_closed;
        let waited = self.changed.wait_timeout_while(state, timeout, is_idle);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let item = state.items.pop_front();
        let goes_on = !state.is_closed || !state.items.is_empty();
        (item, goes_on)
    }

    /// Notes that a payload was written. The caller has dropped it.
    pub(crate) fn note_written(&self, len_bytes: usize, held: Option<HeldBy>) {
        let mut state = self.lock();
        state.waiting_bytes -= len_bytes as u64;
        state.written.messages += 1;
        state.written.bytes += len_bytes as u64;
        if let Some(HeldBy(topic)) = held
            && let Some(count) = state.held.get_mut(topic)
        {
            *count -= 1;
        }
        if std::mem::take(&mut state.is_refused) {
            // It fails only if the number overflows, and the descriptor is readable then.
            let _ = self.room.write(1);
        }
    }

    /// No further item comes.
    pub(crate) fn close(&self) {
        self.lock().is_closed = true;
        self.changed.notify_one();
    }

    /// Notes that writing failed, and drops all items.
    pub(crate) fn fail(&self, error: WriteError) {
        let mut state = self.lock();
        state.failed = Some(error);
        state.has_failed = true;
        state.items.clear();
    }

    pub(crate) fn has_failed(&self) -> bool {
        self.lock().has_failed
    }

    /// The disk shall take no more than what waits already.
    pub(crate) fn note_disk_full(&self) {
        self.lock().is_disk_full = true;
    }

    pub(crate) fn is_disk_full(&self) -> bool {
        self.lock().is_disk_full
    }

    /// The error of the writer, if it failed and nobody has taken the error.
    pub(crate) fn take_error(&self) -> Option<WriteError> {
        self.lock().failed.take()
    }
}
