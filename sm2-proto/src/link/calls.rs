//! The calls of one link without a reply: SPEC section 9 from both ends.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::{BTreeMap, BTreeSet};
use core::mem;

use super::{Misuse, Status};
use crate::{Violation, limits::CALLS_MAX};

/// The calls that a caller made.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Placed {
    calls: BTreeMap<u64, Call>,
    /// The calls whose CANCEL has to be sent.
    cancels: BTreeSet<u64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Call {
    /// Whether its REQUEST has left.
    sent: bool,
    /// Whether the application cancelled it.
    cancelled: bool,
}

impl Placed {
    /// Whether one more call is allowed.
    //= SM2-SRV-002
    pub(super) fn check(&self) -> Result<(), Misuse> {
        if self.calls.len() >= CALLS_MAX {
            Err(Misuse::CallLimit)
        } else {
            Ok(())
        }
    }

    /// The application made a call.
    pub(super) fn place(&mut self, call: u64) {
        self.calls.insert(call, Call::default());
    }

    /// Its REQUEST left.
    pub(super) fn sent(&mut self, call: u64) {
        if let Some(state) = self.calls.get_mut(&call) {
            state.sent = true;
            if state.cancelled {
                self.cancels.insert(call);
            }
        }
    }

    /// The application no longer wants the reply; `last` is its last call.
    /// One that has its reply is left alone.
    //= SM2-SRV-004
    pub(super) fn cancel(&mut self, call: u64, last: Option<u64>) -> Result<(), Misuse> {
        match self.calls.get_mut(&call) {
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

    /// Whether this REPLY may come.
    //= SM2-SRV-003
    pub(super) fn check_reply(&self, call: u64, status: Status, len: u64) -> Result<(), Violation> {
        if !self.calls.get(&call).is_some_and(|state| state.sent) {
            return Err(violation!(UnknownCall, "SM2-SRV-003"));
        }
        if !status.has_payload() && len != 0 {
            return Err(violation!(BadLength, "SM2-SRV-003"));
        }
        Ok(())
    }

    /// A REPLY came.
    pub(super) fn replied(&mut self, call: u64) {
        self.calls.remove(&call);
        self.cancels.remove(&call);
    }

    /// Whether a CANCEL has to be sent.
    pub(super) fn has_cancels(&self) -> bool {
        !self.cancels.is_empty()
    }

    /// The next call whose CANCEL has to be sent.
    pub(super) fn poll(&mut self) -> Option<u64> {
        self.cancels.pop_first()
    }

    /// How many calls have no reply.
    pub(super) fn len(&self) -> usize {
        self.calls.len()
    }

    /// The link is over. Gives the calls that will not get a reply, the oldest first.
    //= SM2-SRV-005
    pub(super) fn end(&mut self) -> impl Iterator<Item = u64> + use<> {
        self.cancels.clear();
        mem::take(&mut self.calls).into_keys()
    }

    /// What must hold between any two calls.
    pub(super) fn invariants(&self) {
        debug_assert!(self.calls.len() <= CALLS_MAX);
        let is_due = |call| {
            self.calls
                .get(call)
                .is_some_and(|it| it.sent && it.cancelled)
        };
        debug_assert!(self.cancels.iter().all(is_due));
    }
}

/// The calls that a server got.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Served {
    /// Every call whose REPLY the caller has not released.
    calls: BTreeMap<u64, Got>,
    /// How many of them have no REPLY that has left.
    open: usize,
    /// The id of the last REQUEST.
    last: Option<u64>,
    /// Ring lane: the calls that were cancelled before their request was taken.
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
    /// It has, and the REPLY has not left.
    Queued,
    /// The REPLY has left.
    Sent,
}

impl Got {
    /// Notes a CANCEL; whether the application has to know. None: this is the second one.
    const fn cancel(&mut self) -> Option<bool> {
        if self.cancelled {
            return None;
        }
        self.cancelled = true;
        Some(matches!(self.reply, Reply::Owed))
    }
}

impl Served {
    /// Whether this REQUEST may come.
    //= SM2-SRV-002
    pub(super) fn check_request(&self, call: u64) -> Result<(), Violation> {
        if call <= self.last.unwrap_or(0) {
            return Err(violation!(BadId, "SM2-SRV-002"));
        }
        if self.open >= CALLS_MAX {
            return Err(violation!(CallLimit, "SM2-SRV-002"));
        }
        Ok(())
    }

    /// A REQUEST came.
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

    /// CANCEL came. Whether the application has to know.
    //= SM2-SRV-004
    pub(super) fn cancel(&mut self, call: u64) -> Result<bool, Violation> {
        let got = self
            .calls
            .get_mut(&call)
            .ok_or(violation!(UnknownCall, "SM2-SRV-004"))?;
        got.cancel().ok_or(violation!(BadCancel, "SM2-SRV-004"))
    }

    /// CANCEL came on the ring lane, where it overtakes requests and is overtaken by replies.
    /// No more than `most` requests are on their way. Whether the application has to know.
    //= SM2-RNG-012
    pub(super) fn cancel_of_ring(&mut self, call: u64, most: usize) -> Result<bool, Violation> {
        if let Some(got) = self.calls.get_mut(&call) {
            return match got.cancel() {
                Some(is_new) => Ok(is_new),
                None => Err(violation!(BadCancel, "SM2-RNG-012")),
            };
        }
        if self.last.is_some_and(|last| call <= last) {
            return Ok(false);
        }
        if self.early.contains(&call) {
            return Err(violation!(BadCancel, "SM2-RNG-012"));
        }
        if self.early.len() >= most {
            return Err(violation!(UnknownCall, "SM2-RNG-012"));
        }
        self.early.insert(call);
        Ok(false)
    }

    /// A request was taken out of a ring. Whether it is cancelled already.
    //= SM2-RNG-012, SM2-SRV-002
    pub(super) fn taken_from_ring(&mut self, call: u64) -> Result<bool, Violation> {
        self.check_request(call)?;
        if self.early.first().is_some_and(|early| *early < call) {
            return Err(violation!(UnknownCall, "SM2-RNG-012"));
        }
        self.requested(call);
        if self.early.remove(&call) {
            self.cancel(call)
        } else {
            Ok(false)
        }
    }

    /// Whether the application may reply.
    //= SM2-SRV-003
    pub(super) fn check(&self, call: u64) -> Result<(), Misuse> {
        match self.calls.get(&call) {
            Some(Got {
                reply: Reply::Owed, ..
            }) => Ok(()),
            _ => Err(Misuse::UnknownCall),
        }
    }

    /// The application replied.
    pub(super) fn reply(&mut self, call: u64) {
        if let Some(got) = self.calls.get_mut(&call) {
            got.reply = Reply::Queued;
        }
    }

    /// Its REPLY left.
    pub(super) fn sent(&mut self, call: u64) {
        if let Some(got) = self.calls.get_mut(&call)
            && got.reply == Reply::Queued
        {
            got.reply = Reply::Sent;
            self.open -= 1;
        }
    }

    /// The caller released the REPLY: it will not name the call again.
    pub(super) fn released(&mut self, call: u64) {
        self.calls.remove(&call);
    }

    /// How many calls have no reply.
    pub(super) const fn len(&self) -> usize {
        self.open
    }

    /// The link is over: nobody waits for a reply.
    pub(super) fn end(&mut self) {
        self.calls.clear();
        self.early.clear();
        self.open = 0;
    }

    /// What must hold between any two calls.
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
