//! The calls of one link that have no reply yet: SPEC section 9 at both ends.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::BTreeSet;
use core::mem;

use super::{Misuse, Status};
use crate::{GrowingMap, Violation, limits::CALLS_MAX};

/// The calls that a caller made.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Placed {
    calls: GrowingMap<u64, Call>,
    /// The calls that need a CANCEL.
    cancels: BTreeSet<u64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Call {
    /// Whether its REQUEST was sent.
    sent: bool,
    /// Whether the application cancelled it.
    cancelled: bool,
}

impl Placed {
    /// Checks whether one more call is allowed.
    //= SM2-SRV-001
    pub(super) fn check(&self) -> Result<(), Misuse> {
        if self.calls.len() >= CALLS_MAX {
            Err(Misuse::CallLimit)
        } else {
            Ok(())
        }
    }

    /// Records a call that the application made.
    pub(super) fn place(&mut self, call: u64) {
        self.calls.insert(call, Call::default());
    }

    /// Records that the REQUEST of this call was sent.
    pub(super) fn sent(&mut self, call: u64) {
        if let Some(state) = self.calls.get_mut(call) {
            state.sent = true;
            if state.cancelled {
                self.cancels.insert(call);
            }
        }
    }

    /// Called when the application no longer wants the reply; `last` is the id of its last call. A
    /// call that already has its reply is not affected.
    //= SM2-SRV-003
    pub(super) fn cancel(&mut self, call: u64, last: Option<u64>) -> Result<(), Misuse> {
        match self.calls.get_mut(call) {
            Some(state) if state.cancelled => Ok(()),
            Some(state) => {
                state.cancelled = true;
                if state.sent {
                    self.cancels.insert(call);
                }
                Ok(())
            }
            None if last.is_some_and(|last| call <= last) => Ok(()),
            None => Err(Misuse::UnknownCall),
        }
    }

    /// Checks whether this REPLY is legal now.
    //= SM2-SRV-002
    pub(super) fn check_reply(&self, call: u64, status: Status, len: u64) -> Result<(), Violation> {
        if !self.calls.get(call).is_some_and(|state| state.sent) {
            return Err(violation!(UnknownCall, "SM2-SRV-002"));
        }
        if !status.has_payload() && len != 0 {
            return Err(violation!(BadLength, "SM2-SRV-002"));
        }
        Ok(())
    }

    /// Records a REPLY that came.
    pub(super) fn replied(&mut self, call: u64) {
        self.calls.remove(call);
        self.cancels.remove(&call);
    }

    /// Whether a CANCEL has to be sent.
    pub(super) fn has_cancels(&self) -> bool {
        !self.cancels.is_empty()
    }

    /// Returns the next call that needs a CANCEL.
    pub(super) fn poll(&mut self) -> Option<u64> {
        self.cancels.pop_first()
    }

    /// The number of calls without a reply.
    pub(super) fn len(&self) -> usize {
        self.calls.len()
    }

    /// Ends all calls with the link. Returns the calls that will not get a reply, the oldest first.
    //= SM2-SRV-004
    pub(super) fn end(&mut self) -> impl Iterator<Item = u64> + use<> {
        self.cancels.clear();
        mem::take(&mut self.calls).into_keys()
    }

    /// Checks the invariants, which hold after each call.
    pub(super) fn invariants(&self) {
        debug_assert!(self.calls.len() <= CALLS_MAX);
        let is_due = |call: &u64| {
            self.calls
                .get(*call)
                .is_some_and(|it| it.sent && it.cancelled)
        };
        debug_assert!(self.cancels.iter().all(is_due));
    }
}

/// The calls that a server received.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Served {
    /// Every call whose REPLY the caller has not released.
    calls: GrowingMap<u64, Got>,
    /// How many of these calls have no REPLY that was sent.
    open: usize,
    /// The id of the last REQUEST.
    last: Option<u64>,
    /// Ring lane: the calls that were cancelled before their request was taken from the ring.
    early: BTreeSet<u64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Got {
    reply: Reply,
    cancelled: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Reply {
    /// The application has not replied.
    Owed,
    /// The application has replied, and the REPLY was not sent yet.
    Queued,
    /// The REPLY was sent.
    Sent,
}

impl Got {
    /// Records a CANCEL. Returns whether the application has to be told; `None` for a second
    /// CANCEL.
    const fn cancel(&mut self) -> Option<bool> {
        if self.cancelled {
            return None;
        }
        self.cancelled = true;
        Some(matches!(self.reply, Reply::Owed))
    }
}

impl Served {
    /// Checks whether this REQUEST is legal now.
    //= SM2-SRV-001
    pub(super) fn check_request(&self, call: u64) -> Result<(), Violation> {
        if call <= self.last.unwrap_or(0) {
            return Err(violation!(BadId, "SM2-SRV-001"));
        }
        if self.open >= CALLS_MAX {
            return Err(violation!(CallLimit, "SM2-SRV-001"));
        }
        Ok(())
    }

    /// Records a REQUEST that came.
    pub(super) fn requested(&mut self, call: u64) {
        self.last = Some(call);
        self.open += 1;
        self.calls.insert(
            call,
            Got {
                reply: Reply::Owed,
                cancelled: false,
            },
        );
    }

    /// Handles CANCEL. Returns whether the application has to be told.
    //= SM2-SRV-003
    pub(super) fn cancel(&mut self, call: u64) -> Result<bool, Violation> {
        let got = self
            .calls
            .get_mut(call)
            .ok_or(violation!(UnknownCall, "SM2-SRV-003"))?;
        got.cancel().ok_or(violation!(BadCancel, "SM2-SRV-003"))
    }

    /// Handles CANCEL on the ring lane, where CANCEL can overtake its request, and the reply can
    /// overtake CANCEL. At most `most` requests are in the ring. Returns whether the application
    /// has to be told.
    //= SM2-RNG-011
    pub(super) fn cancel_of_ring(&mut self, call: u64, most: usize) -> Result<bool, Violation> {
        if let Some(got) = self.calls.get_mut(call) {
            return match got.cancel() {
                Some(is_new) => Ok(is_new),
                None => Err(violation!(BadCancel, "SM2-RNG-011")),
            };
        }
        if self.last.is_some_and(|last| call <= last) {
            return Ok(false);
        }
        if self.early.contains(&call) {
            return Err(violation!(BadCancel, "SM2-RNG-011"));
        }
        if self.early.len() >= most {
            return Err(violation!(UnknownCall, "SM2-RNG-011"));
        }
        self.early.insert(call);
        Ok(false)
    }

    /// Records a request that was taken from a ring. Returns whether it is already cancelled.
    //= SM2-RNG-011, SM2-SRV-001
    pub(super) fn taken_from_ring(&mut self, call: u64) -> Result<bool, Violation> {
        self.check_request(call)?;
        if self.early.first().is_some_and(|early| *early < call) {
            return Err(violation!(UnknownCall, "SM2-RNG-011"));
        }
        self.requested(call);
        if self.early.remove(&call) {
            self.cancel(call)
        } else {
            Ok(false)
        }
    }

    /// Checks whether the application may reply.
    //= SM2-SRV-002
    pub(super) fn check(&self, call: u64) -> Result<(), Misuse> {
        match self.calls.get(call) {
            Some(Got {
                reply: Reply::Owed, ..
            }) => Ok(()),
            _ => Err(Misuse::UnknownCall),
        }
    }

    /// Records that the application replied.
    pub(super) fn reply(&mut self, call: u64) {
        if let Some(got) = self.calls.get_mut(call) {
            got.reply = Reply::Queued;
        }
    }

    /// Records that the REPLY of this call was sent.
    pub(super) fn sent(&mut self, call: u64) {
        if let Some(got) = self.calls.get_mut(call)
            && got.reply == Reply::Queued
        {
            got.reply = Reply::Sent;
            self.open -= 1;
        }
    }

    /// Records that the caller released the REPLY: no frame will name the call again.
    pub(super) fn released(&mut self, call: u64) {
        self.calls.remove(call);
    }

    /// The number of calls without a reply that was sent.
    pub(super) const fn len(&self) -> usize {
        self.open
    }

    /// Ends all calls with the link, because no client waits for a reply any more.
    pub(super) fn end(&mut self) {
        self.calls.clear();
        self.early.clear();
        self.open = 0;
    }

    /// Checks the invariants, which hold after each call.
    pub(super) fn invariants(&self) {
        debug_assert!(self.open <= CALLS_MAX);
        let open = self
            .calls
            .values()
            .filter(|it| it.reply != Reply::Sent)
            .count();
        debug_assert_eq!(self.open, open);
        debug_assert!(self.early.first() > self.last.as_ref() || self.early.is_empty());
    }
}
