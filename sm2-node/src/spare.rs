//! Memory for the next sealed message, prepared in advance.
//!
//! A sealed message needs new memory. Allocating it takes as long as writing the message, or several times as
//! long without huge pages. A publisher that sends a stream of sealed messages therefore prepares the memory
//! of the next message after it has sent one: one file, about as long as the last message. The publisher has
//! no thread for this, so its caller spends that time, but no subscriber waits for it.
//!
//! The memory is freed when the publisher is called after some time without a sealed message, and when the
//! publisher is dropped.
//!
//! In the run of `cargo run --release -p sm2-io --example memory` that took 0.73 ms to seal 10 MiB, prepared memory
//! reduced this to 0.31 ms.

use std::io;
use std::os::fd::OwnedFd;
use std::time::Duration;

use sm2_io::memfd::sealed_from_bytes;
use sm2_io::{Preallocated, SealedLoan};
use sm2_proto::Instant;

/// How much longer than the message a file may be: by half the message, or by this.
const SLACK_BYTES: usize = 4_096;

/// Holds at most one prepared file.
#[derive(Debug)]
pub(crate) struct SpareMemory {
    ready: Option<Preallocated>,
    /// The expected need of the next message.
    next: Option<Need>,
    /// The time of the last sealed message.
    last: Option<Instant>,
    idle: Duration,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Need {
    capacity: usize,
    fill: Fill,
}

/// How a message is written into its memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fill {
    Copy,
    InPlace,
}

impl SpareMemory {
    /// Creates an empty value. It prepares no memory for messages that are more than `idle` apart.
    pub(crate) const fn new(idle: Duration) -> Self {
        Self {
            ready: None,
            next: None,
            last: None,
            idle,
        }
    }

    /// Takes the prepared memory if it suits a message of `len` bytes.
    pub(crate) fn take(&mut self, len: usize, fill: Fill, now: Instant) -> Option<Preallocated> {
        let streams = self.last.is_some_and(|last| now.since(last) <= self.idle);
        self.last = Some(now);
        // If lengths vary a little, the capacity for the longest one is kept.
        let known = self.next.map(|next| next.capacity);
        let capacity = known.filter(|&capacity| fits(len, capacity));
        let capacity = capacity.unwrap_or_else(|| len.next_multiple_of(SLACK_BYTES));
        self.next = streams.then_some(Need { capacity, fill });
        self.ready
            .take()
            .filter(|it| fits(len, it.capacity_bytes()))
    }

    /// Prepares memory for the next message, or frees memory that no message needed for long.
    pub(crate) fn refill(&mut self, now: impl FnOnce() -> Instant) {
        if self.ready.is_none() && self.next.is_none() {
            return;
        }
        let now = now();
        if self.last.is_none_or(|last| now.since(last) > self.idle) {
            (self.ready, self.next) = (None, None);
        }
        if let (None, Some(Need { capacity, fill })) = (&self.ready, self.next) {
            let made = match fill {
                Fill::Copy => Preallocated::for_copies(capacity),
                Fill::InPlace => Preallocated::for_loans(capacity),
            };
            match made {
                Ok(preallocated) => self.ready = Some(preallocated),
                // The next message allocates for itself, and reports the error if it fails too.
                Err(error) => tracing::debug!(%error, "cannot prepare memory for the next message"),
            }
        }
    }
}

/// Whether a file of this capacity suits a message of `len` bytes.
const fn fits(len: usize, capacity: usize) -> bool {
    len <= capacity
        && capacity - len
            <= if len / 2 > SLACK_BYTES {
                len / 2
            } else {
                SLACK_BYTES
            }
}

/// Returns a sealed copy of `bytes`, in the prepared memory if there is any.
pub(crate) fn seal(ready: Option<Preallocated>, bytes: &[u8]) -> io::Result<OwnedFd> {
    match ready {
        Some(preallocated) => preallocated.fill(bytes),
        None => sealed_from_bytes(bytes),
    }
}

/// Returns a loan of `len` bytes, in the prepared memory if there is any.
pub(crate) fn lend(ready: Option<Preallocated>, len: usize) -> io::Result<SealedLoan> {
    match ready {
        Some(preallocated) => preallocated.lend(len),
        None => SealedLoan::new(len as u64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn refill(spare: &mut SpareMemory, seconds: u64) -> Option<usize> {
        spare.refill(|| Instant(seconds * SECOND));
        spare.ready.as_ref().map(Preallocated::capacity_bytes)
    }

    #[test]
    fn a_stream_finds_memory_ready_and_a_single_message_leaves_none() {
        let mut spare = SpareMemory::new(Duration::from_secs(5));
        assert_eq!(refill(&mut spare, 0), None);
        assert!(spare.take(10_000, Fill::Copy, Instant(SECOND)).is_none());
        assert_eq!(refill(&mut spare, 1), None, "no stream of messages yet");
        assert!(
            spare
                .take(10_000, Fill::Copy, Instant(7 * SECOND))
                .is_none()
        );
        assert_eq!(refill(&mut spare, 7), None, "more than 5 s later");
        assert!(
            spare
                .take(10_000, Fill::Copy, Instant(8 * SECOND))
                .is_none()
        );
        assert_eq!(refill(&mut spare, 8), Some(12_288));
        let preallocated = spare.take(12_000, Fill::Copy, Instant(9 * SECOND)).unwrap();
        assert_eq!(
            seal(Some(preallocated), &[1; 12_000]).map(|_| ()).ok(),
            Some(())
        );
        assert_eq!(refill(&mut spare, 9), Some(12_288));
        assert_eq!(refill(&mut spare, 14), Some(12_288));
        assert_eq!(refill(&mut spare, 15), None, "it was unused for too long");
        assert!(
            spare
                .take(10_000, Fill::InPlace, Instant(15 * SECOND))
                .is_none()
        );
    }

    #[test]
    fn what_is_ready_is_not_wasted_on_short_messages() {
        let mut spare = SpareMemory::new(Duration::MAX);
        for len in [1_000_000, 900_000, 100_000, 100_001, 1_000_000] {
            let before = refill(&mut spare, 1);
            let taken = spare.take(len, Fill::InPlace, Instant(SECOND));
            let expected = before.filter(|&capacity| fits(len, capacity));
            assert_eq!(taken.map(|it| it.capacity_bytes()), expected, "{len}");
        }
        assert_eq!(refill(&mut spare, 1), Some(1_003_520));
        assert!(fits(1, 4_097) && !fits(1, 4_098) && fits(9, 9) && !fits(9, 8));
        assert!(fits(1_000_000, 1_500_000) && !fits(1_000_000, 1_500_001));
        assert!(fits(3_000, 7_096) && !fits(3_000, 7_097));
        assert!(fits(8_194, 12_291) && !fits(8_194, 12_292));
    }

    #[test]
    fn a_loan_from_what_is_ready_is_empty_and_as_long_as_asked() {
        let preallocated = Preallocated::for_loans(8_192).unwrap();
        let loan = lend(Some(preallocated), 5_000).unwrap();
        assert_eq!(loan.as_slice(), [0; 5_000]);
        assert_eq!(lend(None, 7).unwrap().len(), 7);
    }
}
