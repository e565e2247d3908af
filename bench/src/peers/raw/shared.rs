//! Both sides wait at the shared memory itself: asleep, or spinning.

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

/// How often a spinning side looks at the clock.
const SPINS: u32 = 1_024;

/// How a side waits for the other one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Waiting {
    Futex,
    Spin,
}

/// Writes.
pub struct SharedSender {
    region: Region,
    waiting: Waiting,
    published: u64,
    /// What the slowest subscriber had consumed when that was looked at.
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
        // SAFETY: this is the channel's only publisher, and the slowest subscriber has consumed
        // what was in the slot: that was just waited for.
        write(unsafe { self.region.write(self.published, len) });
        self.published += 1;
        let counters = self.region.counters();
        match self.waiting {
            Waiting::Spin => (counters.published.0).store(self.published, Ordering::Release),
            Waiting::Futex => {
                // Pairs with the subscriber's: it announces its sleep, and then looks again.
                (counters.published.0).store(self.published, Ordering::SeqCst);
                fence(Ordering::SeqCst);
                ring(&counters.sleepers.0, &counters.bell.0);
            }
        }
        Ok(())
    }

    /// Until everybody has consumed what is in the next slot.
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
            return Err(PeerError::new("publish", "a subscriber does not take"));
        }
        self.slowest = slowest;
        Ok(())
    }
}

/// Reads.
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
                // SAFETY: it is published, and not consumed yet.
                let flow = handler.message(unsafe { self.region.read(self.consumed, self.len) });
                self.consumed += 1;
                counters.consume(self.place, self.consumed);
                if self.waiting == Waiting::Futex {
                    // Pairs with the publisher's: it announces its sleep, and then looks again.
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

/// Wakes those who sleep, if there are any.
fn ring(sleepers: &AtomicU32, bell: &AtomicU32) {
    if sleepers.load(Ordering::SeqCst) != 0 {
        bell.fetch_add(1, Ordering::SeqCst);
        futex::wake_all(bell);
    }
}

/// Waits until `there`; whether it was in time.
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
        let heard = bell.load(Ordering::SeqCst);
        fence(Ordering::SeqCst);
        if there() {
            break true;
        }
        let now = now_ns();
        if now >= until_ns {
            break false;
        }
        futex::wait(bell, heard, Duration::from_nanos(until_ns - now));
    };
    sleepers.fetch_sub(1, Ordering::SeqCst);
    in_time
}
