//! What callers and servers do with rings beyond sending and receiving: SPEC section 9 on the ring
//! lane.

use super::super::{
    At, Delivery, Error, Fate, Link, Misuse, Output, RingMemory, Role, Wake,
    lane::Lane,
    ring::{RingMessage, Unsent, Waiting},
};
use crate::{Violation, clause};

impl Link {
    /// Whether this is an end of a service's link.
    pub(super) const fn has_calls(&self) -> bool {
        matches!(self.config.role, Role::Caller | Role::Server)
    }

    /// Sends a caller's request or a server's reply, or lets it wait.
    pub(super) fn queue_for_ring(
        &mut self,
        words: &impl RingMemory,
        message: &RingMessage,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, Error> {
        self.check_queue(message)?;
        match self.config.role {
            Role::Server => self.served.reply(message.id),
            _ => self.placed.place(message.id),
        }
        if let Lane::Ring(ring) = &mut self.lane {
            ring.waiting.push(*message);
        }
        self.send_waiting(words, settled)
            .map_err(|violation| self.violated(violation))
    }

    //= SM2-SRV-002, SM2-SRV-003
    fn check_queue(&self, message: &RingMessage) -> Result<(), Misuse> {
        let Lane::Ring(ring) = &self.lane else {
            return Err(Misuse::NotOpen);
        };
        if ring.is_awaited() {
            return Err(Misuse::NotOpen);
        }
        match self.config.role {
            Role::Server => self.served.check(message.id)?,
            _ => {
                self.placed.check()?;
                if message.id <= ring.last_id().unwrap_or(0) {
                    return Err(Misuse::IdNotGrowing);
                }
            }
        }
        Waiting::check(message)
    }

    /// Sends messages that wait, as far as there is room. If some are left for want of room, this
    /// end parks, so that the other end wakes it, and looks once more.
    //= SM2-RNG-009
    pub(super) fn send_waiting(
        &mut self,
        words: &impl RingMemory,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, Violation> {
        let first = self.put_waiting(words, settled)?;
        // A segment that is missing and a socket that takes nothing wake this end by the socket.
        if !matches!(&self.lane, Lane::Ring(ring) if ring.waiting.is_full) {
            return Ok(first);
        }
        words.swap(At::SenderParked, 1);
        // Pairs with the fence in `wake_parked`, after the other end took a word or gave one back.
        words.fence();
        if let Lane::Ring(ring) = &mut self.lane
            && let Some(sender) = ring.sender_mut()
        {
            sender.harvest(words, settled)?;
        }
        let second = self.put_waiting(words, settled)?;
        Ok(first.or(second))
    }

    fn put_waiting(
        &mut self,
        words: &impl RingMemory,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, Violation> {
        let mut wake = Wake::NotNeeded;
        let Lane::Ring(ring) = &mut self.lane else {
            return Ok(wake);
        };
        let Some((sender, waiting)) = ring.sender_and_waiting().filter(|_| !self.blocked) else {
            return Ok(wake);
        };
        waiting.is_full = false;
        while let Some(message) = waiting.front() {
            let (id, segment) = (message.id, message.segment);
            match sender.send(words, message, settled) {
                Ok(wanted) => wake = wake.or(wanted),
                Err(Unsent::Violation(violation)) => {
                    // The sender settles it with all others.
                    waiting.pop();
                    return Err(violation);
                }
                Err(Unsent::Misuse(Misuse::NotAttached)) => {
                    // If the number is not free yet, DETACHED will come.
                    let _ = sender.attach(&segment);
                    break;
                }
                Err(why) => {
                    waiting.is_full = why == Unsent::Misuse(Misuse::NoRoom);
                    break;
                }
            }
            waiting.pop();
            match self.config.role {
                Role::Server => {
                    // No frame tells when the caller will not name the call any more.
                    self.served.sent(id);
                    self.served.released(id);
                }
                _ => self.placed.sent(id),
            }
        }
        Ok(wake)
    }

    /// Notes what a message that was taken, or that none was there, means for calls.
    //= SM2-RNG-004, SM2-SRV-003
    pub(super) fn note_call(&mut self, taken: Option<&Delivery>) -> Result<(), Violation> {
        match (self.config.role, taken) {
            // After the end nobody waits for a reply.
            (Role::Server, Some(request)) if self.state.is_ok() => {
                let call = request.id;
                if self.served.taken_from_ring(call)? {
                    self.events.push_back(Output::Cancelled { call });
                }
            }
            (Role::Caller, Some(reply)) => {
                let legal = self.placed.check_reply(reply.id, reply.status, reply.len);
                legal.map_err(|it| Violation::new(it.kind(), clause!("SM2-RNG-004")))?;
                self.placed.replied(reply.id);
                if self.state.is_err() {
                    self.fail_calls();
                }
            }
            // A reply that a server puts there from now on is too late.
            (Role::Caller, None) if self.state.is_err() => self.end_ring(),
            _ => {}
        }
        Ok(())
    }

    /// Whether replies of a link that is over can still be taken.
    //= SM2-RNG-011
    pub(in crate::link) fn may_bring_replies(&self) -> bool {
        let Lane::Ring(ring) = &self.lane else {
            return false;
        };
        let receiver = ring.incoming.as_ref().filter(|_| !ring.is_awaited());
        self.config.role == Role::Caller && receiver.is_some_and(|it| !it.is_over())
    }

    /// The link is over: calls without a reply fail, if no reply can come any more.
    //= SM2-SRV-005
    pub(in crate::link) fn fail_calls(&mut self) {
        if !self.may_bring_replies() {
            let failed = self.placed.end();
            (self.events).extend(failed.map(|call| Output::CallFailed { call }));
        }
    }
}
