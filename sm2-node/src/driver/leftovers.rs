//! Memory of messages that goes back to the system in parts.
//!
//! A subscriber that dies with many messages leaves whole segments that must not be written again (SM2-OPN-010), and a
//! publisher that rests has segments that it does not need. Giving back hundreds of megabytes takes as long as many
//! messages, and the kernel locks the mappings of the process meanwhile. So the call that finds such memory only moves
//! it here. The control side then gives it back: at most [`PART_BYTES`] at a time, without a lock of the node, and with
//! other events handled in between.

use std::collections::VecDeque;
use std::io;
use std::os::fd::OwnedFd;

use sm2_io::{Interest, SegmentFd, UnusedSegment, Waker};

use super::event_sets::NodeSets;
use super::token::LEFTOVERS;

/// How much is unmapped at a time. A file is closed in one piece, which bounds the sizes of segments
/// (`pool::sizes::SEGMENT_BYTES`).
pub(super) const PART_BYTES: usize = 4 << 20;

/// Memory that no message needs any more.
#[derive(Debug)]
pub(crate) enum Leftover {
    /// A segment.
    Segment(SegmentFd),
    /// A partly unmapped segment.
    Unmapping(UnusedSegment),
    /// The file of a sealed message.
    File(OwnedFd),
}

impl Leftover {
    /// Gives back one part. Returns the rest.
    pub(super) fn release_part(self) -> Option<Self> {
        let mut segment = match self {
            Self::Segment(fd) => fd.into_unused()?,
            Self::Unmapping(segment) => segment,
            Self::File(file) => {
                drop(file);
                return None;
            }
        };
        (!segment.unmap_part(PART_BYTES)).then_some(Self::Unmapping(segment))
    }
}

/// The memory that the control side has to give back.
#[derive(Debug, Default)]
pub(super) struct Leftovers {
    queue: VecDeque<Leftover>,
    /// Wakes the control side as long as there is something to give back.
    waker: Option<Waker>,
}

impl Leftovers {
    /// Adds memory. Without a descriptor to wake the control side, gives it back at once.
    pub(super) fn add(&mut self, leftovers: Vec<Leftover>, sets: &NodeSets) {
        match self.wake(sets) {
            Ok(()) => self.queue.extend(leftovers),
            Err(error) => {
                tracing::debug!(%error, "memory goes back to the system at once");
                drop(leftovers);
            }
        }
    }

    fn wake(&mut self, sets: &NodeSets) -> io::Result<()> {
        if self.waker.is_none() {
            let waker = Waker::new()?;
            sets.control.add(&waker, LEFTOVERS, Interest::READABLE)?;
            waker.wake();
            self.waker = Some(waker);
        }
        Ok(())
    }

    /// Takes the next memory to give back. The caller puts the rest of it back.
    pub(super) fn next(&mut self, sets: &NodeSets) -> Option<Leftover> {
        let next = self.queue.pop_front();
        if next.is_none()
            && let Some(waker) = self.waker.take()
        {
            let _ = sets.control.remove(&waker);
        }
        next
    }

    /// Puts back the rest of what was taken.
    pub(super) fn put_back(&mut self, rest: Option<Leftover>) {
        if let Some(rest) = rest {
            self.queue.push_front(rest);
        }
    }
}
