//! Calls on the ring lane: the work of callers and servers beyond sending and receiving (SPEC
//! section 9).
//!
//! As on topics, each end creates the ring that it takes from, so a service has two rings, and the ring of topics
//! serves both. A caller's ring has `window - 1` places, at most 1,024, and not only `depth`: enough for the replies to
//! all its calls. A message without room waits in the machine, where the limit of calls bounds the queue, so no reply
//! is refused. Whenever messages wait, the machine itself parks for room, whether or not a thread sleeps, and only then
//! does the peer ring the bell for room. CANCEL stays on the socket: in the ring, it would wait behind the request that
//! it cancels. On the socket it can arrive early or late, and SM2-RNG-011 states how far a server relies on it.

use super::super::{
    At, Delivery, Error, Fate, Link, Misuse, Output, RingMemory, Role, Wake,
    calls::{Placed, Served},
    lane::Lane,
    ring::{RingMessage, RingSendError, SendQueue},
};
use crate::{Violation, clause};

impl Link {
    /// Whether this end belongs to a link of a service.
    pub(super) const fn has_calls(&self) -> bool {
        matches!(self.config.role, Role::Caller | Role::Server)
    }

    /// Sends a caller's request or a server's reply, or queues it until there is room.
    pub(super) fn queue_for_ring(
        &mut self,
        words: &impl RingMemory,
        message: &RingMessage,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, Error> {
        self.check_call(message.id)?;
        SendQueue::check(message)?;
        self.note_made_call(message.id);
        if let Lane::Ring(ring) = &mut self.lane {
            ring.queue.push(*message);
        }
        self.send_queued(words, settled)
            .map_err(|violation| self.violated(violation))
    }

    //= SM2-SRV-001, SM2-SRV-002
    fn check_call(&self, id: u64) -> Result<(), Misuse> {
        let Lane::Ring(ring) = &self.lane else {
            return Err(Misuse::NotOpen);
        };
        if ring.is_awaited() {
            return Err(Misuse::NotOpen);
        }
        match self.config.role {
            Role::Server => self.served.check(id)?,
            _ => {
                self.placed.check()?;
                if id <= ring.last_id().unwrap_or(0) {
                    return Err(Misuse::IdNotGrowing);
                }
            }
        }
        Ok(())
    }

    /// Checks whether a request or a reply may be sent in a cell: not before those that wait.
    pub(super) fn check_call_in_cell(&self, id: u64) -> Result<(), Misuse> {
        self.check_call(id)?;
        match &self.lane {
            Lane::Ring(ring) if ring.has_queued() => Err(Misuse::NoRoom),
            _ => Ok(()),
        }
    }

    /// Updates the calls for a request or a reply that the application made.
    fn note_made_call(&mut self, id: u64) {
        match self.config.role {
            Role::Server => self.served.reply(id),
            _ => self.placed.place(id),
        }
    }

    /// Updates the calls for a request or a reply that was sent in a cell.
    pub(super) fn note_sent_call(&mut self, id: u64) {
        self.note_made_call(id);
        note_sent(self.config.role, &mut self.placed, &mut self.served, id);
    }

    /// Sends queued messages while there is room. If some remain for lack of room, this end parks,
    /// so that the other end wakes it, and then tries once more.
    //= SM2-RNG-012
    pub(super) fn send_queued(
        &mut self,
        words: &impl RingMemory,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, Violation> {
        let first = self.put_queued(words, settled)?;
        // If a segment is missing or the socket is blocked, the socket wakes this end, so it need
        // not park.
        if !matches!(&self.lane, Lane::Ring(ring) if ring.queue.is_full) {
            return Ok(first);
        }
        words.swap(At::SenderParked, 1);
        // Pairs with the SeqCst fence in `wake_parked`, which the other end executes after it took
        // a word or gave one back.
        words.fence();
        if let Lane::Ring(ring) = &mut self.lane
            && let Some(sender) = ring.sender_mut()
        {
            sender.harvest(words, settled)?;
        }
        let second = self.put_queued(words, settled)?;
        Ok(first.or(second))
    }

    fn put_queued(
        &mut self,
        words: &impl RingMemory,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, Violation> {
        let mut wake = Wake::NotNeeded;
        let Lane::Ring(ring) = &mut self.lane else {
            return Ok(wake);
        };
        let Some((sender, queue)) = ring.sender_and_queue().filter(|_| !self.blocked) else {
            return Ok(wake);
        };
        queue.is_full = false;
        while let Some(message) = queue.front() {
            let (id, segment) = (message.id, message.segment);
            match sender.send(words, message, settled) {
                Ok(wanted) => wake = wake.or(wanted),
                Err(RingSendError::Violation(violation)) => {
                    // The end of the link settles this message with all others of the sender.
                    queue.pop();
                    return Err(violation);
                }
                Err(RingSendError::Misuse(Misuse::NotAttached)) => {
                    // If the number is still in use, DETACHED will free it, and this end tries
                    // again.
                    let _ = sender.segments.attach(&segment);
                    break;
                }
                Err(why) => {
                    queue.is_full = why == RingSendError::Misuse(Misuse::NoRoom);
                    break;
                }
            }
            queue.pop();
            note_sent(self.config.role, &mut self.placed, &mut self.served, id);
        }
        Ok(wake)
    }

    /// Updates the calls for a message that was taken, or for a look that found none.
    //= SM2-RNG-004, SM2-SRV-002
    pub(super) fn note_call<C>(&mut self, taken: Option<&Delivery<C>>) -> Result<(), Violation> {
        match (self.config.role, taken) {
            // After the end, no client waits for a reply.
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
            // A reply that the server puts into the ring after this look is too late.
            (Role::Caller, None) if self.state.is_err() => self.end_ring(),
            _ => {}
        }
        Ok(())
    }

    /// Whether the application can still take replies of a link that is over.
    //= SM2-RNG-010
    pub(in crate::link) fn may_bring_replies(&self) -> bool {
        let Lane::Ring(ring) = &self.lane else {
            return false;
        };
        let receiver = ring.incoming.as_ref().filter(|_| !ring.is_awaited());
        self.config.role == Role::Caller && receiver.is_some_and(|it| !it.is_over())
    }

    /// Fails the calls without a reply, if the link is over and no reply can come any more.
    //= SM2-SRV-004
    pub(in crate::link) fn fail_calls(&mut self) {
        if !self.may_bring_replies() {
            let failed = self.placed.end();
            (self.events).extend(failed.map(|call| Output::CallFailed { call }));
        }
    }
}

/// Updates the calls for a request or a reply that is in the ring.
fn note_sent(role: Role, placed: &mut Placed, served: &mut Served, id: u64) {
    match role {
        Role::Server => {
            // On the ring lane, no frame tells when the caller stops naming the call.
            served.sent(id);
            served.released(id);
        }
        _ => placed.sent(id),
    }
}
