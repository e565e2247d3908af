//! Shared memory alone: both sides wait at its words, with a futex or by spinning.

use std::{
    hint, io,
    path::Path,
    sync::atomic::{AtomicU32, Ordering, fence},
    time::Duration,
};

use super::{
    futex,
    region::{FREE, Region, slots},
};
use crate::{
    clock::now_ns,
    peers::contract::{Flow, Handler, PeerError, TIMEOUT_NS},
};

/// The number of spins between two readings of the clock.
const SPINS: u32 = 1_024;

/// How a side waits for the other one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Waiting {
    Futex,
    Spin,
}

/// The sending end.
pub struct SharedSender {
    region: Region,
    waiting: Waiting,
    published: u64,
    /// The number of messages that the slowest subscriber had consumed when it was last read.
    slowest: u64,
}

impl SharedSender {
    pub(super) fn new(memory: &Path, len: usize, waiting: Waiting) -> io::Result<Self> {
        Ok(Self {
            region: Region::open(memory, len, slots(len))?,
            waiting,
            published: 0,
            slowest: 0,
        })
    }

    pub(super) fn matched(&self) -> usize {
        self.region.counters().joined()
    }

    pub(super) fn publish(
        &mut self,
        len: usize,
        write: impl FnOnce(&mut [u8]),
    ) -> Result<(), PeerError> {
        self.wait_for_room()?;
        // SAFETY: this is the channel's only publisher, and `wait_for_room` has waited until the
        // slowest subscriber had consumed the earlier message in the slot.
        write(unsafe { self.region.write(self.published, len) });
        self.published += 1;
        let counters = self.region.counters();
        match self.waiting {
            Waiting::Spin => (counters.published.0).store(self.published, Ordering::Release),
            Waiting::Futex => {
                // Pairs with the SeqCst fence in the subscriber's `wait`, between its entry in
                // `sleepers` and its last look at `published`: one side sees the other's store.
                (counters.published.0).store(self.published, Ordering::SeqCst);
                fence(Ordering::SeqCst);
                ring(&counters.sleepers.0, &counters.bell.0);
            }
        }
        Ok(())
    }

    /// Waits until every subscriber has consumed the message in the next slot.
    fn wait_for_room(&mut self) -> Result<(), PeerError> {
        let needed = (self.published + 1).saturating_sub(self.region.slots() as u64);
        if self.slowest != FREE && self.slowest >= needed {
            return Ok(());
        }
        let counters = self.region.counters();
        let mut slowest = FREE;
        let until_ns = now_ns() + TIMEOUT_NS;
        let in_time = wait(
            self.waiting,
            (&counters.room_sleepers.0, &counters.room_bell.0),
            until_ns,
            || {
                slowest = counters.slowest();
                slowest >= needed
            },
        );
        if !in_time {
            return Err(PeerError::new("publish", "a subscriber takes no messages"));
        }
        self.slowest = slowest;
        Ok(())
    }
}

/// The receiving end.
pub struct SharedReceiver {
    region: Region,
    waiting: Waiting,
    place: usize,
    consumed: u64,
    len: usize,
}

impl SharedReceiver {
    pub(super) fn new(memory: &Path, len: usize, waiting: Waiting) -> io::Result<Self> {
        let region = Region::open(memory, len, slots(len))?;
        let counters = region.counters();
        let place = counters
            .join()
            .ok_or_else(|| io::Error::other("too many subscribers"))?;
        Ok(Self {
            place,
            consumed: counters.consumed(place),
            waiting,
            len,
            region,
        })
    }

    pub(super) fn pump<H: Handler>(&mut self, handler: &mut H, until_ns: u64) {
        let counters = self.region.counters();
        loop {
            let mut published = 0;
            let consumed = self.consumed;
            let there = wait(
                self.waiting,
                (&counters.sleepers.0, &counters.bell.0),
                until_ns,
                || {
                    published = counters.published.0.load(Ordering::Acquire);
                    published > consumed
                },
            );
            if !there {
                return;
            }
            while self.consumed < published {
                // SAFETY: the message is published, and this subscriber has not consumed it yet.
                let flow = handler.message(unsafe { self.region.read(self.consumed, self.len) });
                self.consumed += 1;
                counters.consume(self.place, self.consumed);
                if self.waiting == Waiting::Futex {
                    // Pairs with the SeqCst fence in the publisher's `wait`, between its entry in
                    // `room_sleepers` and its last look at the counts of consumed messages.
                    fence(Ordering::SeqCst);
                    ring(&counters.room_sleepers.0, &counters.room_bell.0);
                }
                if flow == Flow::Return {
                    return;
                }
            }
        }
    }
}

impl Drop for SharedReceiver {
    fn drop(&mut self) {
        let counters = self.region.counters();
        counters.consume(self.place, FREE);
        fence(Ordering::SeqCst);
        ring(&counters.room_sleepers.0, &counters.room_bell.0);
    }
}

/// Wakes all sleepers, if there are any.
fn ring(sleepers: &AtomicU32, bell: &AtomicU32) {
    if sleepers.load(Ordering::SeqCst) != 0 {
        bell.fetch_add(1, Ordering::SeqCst);
        futex::wake_all(bell);
    }
}

/// Waits until `there` returns true, at most until `until_ns`; returns whether it did.
fn wait(
    waiting: Waiting,
    (sleepers, bell): (&AtomicU32, &AtomicU32),
    until_ns: u64,
    mut there: impl FnMut() -> bool,
) -> bool {
    if there() {
        return true;
    }
    if waiting == Waiting::Spin {
        loop {
            for _ in 0..SPINS {
                if there() {
                    return true;
                }
                hint::spin_loop();
            }
            if now_ns() >= until_ns {
                return there();
            }
        }
    }
    sleepers.fetch_add(1, Ordering::SeqCst);
    let in_time = loop {
        let seen = bell.load(Ordering::SeqCst);
        fence(Ordering::SeqCst);
        if there() {
            break true;
        }
        let now = now_ns();
        if now >= until_ns {
            break false;
        }
        futex::wait(bell, seen, Duration::from_nanos(until_ns - now));
    };
    sleepers.fetch_sub(1, Ordering::SeqCst);
    in_time
}
