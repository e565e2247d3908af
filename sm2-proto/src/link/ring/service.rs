//! What callers and servers do beyond sending and receiving: SPEC section 9 on the ring lane.
//!
//! No call and no reply is refused for want of room: what the ring does not take waits here, in
//! its order. The limit of calls bounds how much that is.

use alloc::collections::VecDeque;

use super::{
    At, Delivery, Error, Fate, Link, Misuse, Outgoing, Output, Ring, RingMemory, RingMessage,
    RingReceiver, Role, Unsent, receiver_of, sender_of,
};
use crate::{
    Violation, clause,
    limits::{CALLS_MAX, MESSAGE_MAX, RING_SEGMENTS_MAX, SLOT_HEAD},
    link::segments::Geometry,
};

/// Messages that wait for room in a ring, the oldest first.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Waiting {
    messages: VecDeque<RingMessage>,
    /// The id of the last message that was ever here.
    last_id: Option<u64>,
    /// Whether the ring had no room for the first of them, when that was last seen.
    is_full: bool,
}

impl Waiting {
    /// Whether a message may be put here, by what will still be so when its turn comes.
    //= SM2-RNG-003, SM2-PAY-008
    fn check(message: &RingMessage) -> Result<(), Misuse> {
        let info = &message.segment;
        let geometry = Geometry::new(info.stride, info.slots).ok_or(Misuse::BadSegment)?;
        if info.id >= RING_SEGMENTS_MAX {
            return Err(Misuse::BadSegment);
        }
        if geometry.offset(message.slot).is_none() {
            return Err(Misuse::SlotOutside);
        }
        if message.len > MESSAGE_MAX.min(info.stride - SLOT_HEAD as u64) {
            return Err(Misuse::TooLong);
        }
        Ok(())
    }

    fn push(&mut self, message: RingMessage) {
        self.last_id = Some(message.id);
        self.messages.push_back(message);
    }

    pub(super) fn len(&self) -> usize {
        self.messages.len()
    }

    /// The link is over. Gives the keys.
    pub(super) fn end(&mut self, each: impl FnMut(u64)) {
        self.messages.drain(..).map(|it| it.key).for_each(each);
        self.is_full = false;
    }

    /// What must hold between any two calls.
    pub(super) fn invariants(&self) {
        debug_assert!(self.len() <= CALLS_MAX);
    }
}

impl Ring {
    /// The id of the last message of a caller or server.
    pub(in crate::link) const fn last_id(&self) -> Option<u64> {
        self.waiting.last_id
    }

    /// How many messages can be on their way to this end.
    pub(in crate::link) fn depth(&self) -> usize {
        let depth = |it: &RingReceiver| usize::from(it.layout().depth());
        self.incoming.as_ref().map_or(0, depth)
    }
}

impl Link {
    /// Whether this is one of the two ends that calls have.
    pub(super) const fn has_calls(&self) -> bool {
        matches!(self.config.role, Role::Caller | Role::Server)
    }

    pub(in crate::link) fn is_ring_awaited(&self) -> bool {
        self.ring.as_ref().is_some_and(Ring::is_awaited)
    }

    /// Caller or server: whether messages wait that nothing is known to hold up:
    /// [`harvest`](Self::harvest) sends them, or finds out what does.
    #[must_use]
    pub fn is_due(&self) -> bool {
        let is_due = |ring: &Ring| {
            let (sender, next) = (ring.sender(), ring.waiting.messages.front());
            let is_attached = |it: &RingMessage| sender.is_some_and(|s| s.is_attached(&it.segment));
            !ring.waiting.is_full && next.is_some_and(is_attached)
        };
        !self.blocked && self.ring.as_ref().is_some_and(is_due)
    }

    /// Caller or server: whether messages wait for room, or for a segment.
    #[must_use]
    pub fn is_waiting(&self) -> bool {
        self.ring.as_ref().is_some_and(|it| it.waiting.len() > 0)
    }

    /// A caller's request or a server's reply; whether the other end wants the bell.
    pub(super) fn queue_for_ring(
        &mut self,
        words: &impl RingMemory,
        message: &RingMessage,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<bool, Error> {
        self.check_queue(message)?;
        match self.config.role {
            Role::Server => self.served.reply(message.id),
            _ => self.placed.place(message.id),
        }
        if let Some(ring) = &mut self.ring {
            ring.waiting.push(*message);
        }
        self.send_waiting(words, settled)
            .map_err(|violation| self.violated(violation))
    }

    //= SM2-SRV-002, SM2-SRV-003
    fn check_queue(&self, message: &RingMessage) -> Result<(), Misuse> {
        let ring = self.ring.as_ref().filter(|it| !it.is_awaited());
        let ring = ring.ok_or(Misuse::WrongLane)?;
        match self.config.role {
            Role::Server => self.served.check(message.id)?,
            _ => {
                self.placed.check()?;
                if ring.last_id().is_some_and(|last| message.id <= last) {
                    return Err(Misuse::IdNotGrowing);
                }
            }
        }
        Waiting::check(message)
    }

    /// Sends what waits, as far as there is room. If some is left, the other end rings the bell
    /// when there is more; and that may have been just now.
    //= SM2-RNG-009
    pub(super) fn send_waiting(
        &mut self,
        words: &impl RingMemory,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<bool, Violation> {
        let first = self.put_waiting(words, settled)?;
        // For a segment, or a socket that takes nothing, it is the socket that wakes.
        if !self.ring.as_ref().is_some_and(|it| it.waiting.is_full) {
            return Ok(first);
        }
        words.swap(At::SenderParked, 1);
        // Pairs with the fence of who takes a word, or gives one back.
        words.fence();
        if let Some(sender) = sender_of(&mut self.ring) {
            sender.harvest(words, settled)?;
        }
        let second = self.put_waiting(words, settled)?;
        Ok(first || second)
    }

    fn put_waiting(
        &mut self,
        words: &impl RingMemory,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<bool, Violation> {
        let mut bell = false;
        let Some(Ring {
            outgoing: Some(Outgoing::Here(sender)),
            waiting,
            ..
        }) = self.ring.as_mut().filter(|_| !self.blocked)
        else {
            return Ok(bell);
        };
        waiting.is_full = false;
        while let Some(message) = waiting.messages.front() {
            let (id, segment) = (message.id, message.segment);
            match sender.send(words, message, settled) {
                Ok(wanted) => bell |= wanted,
                Err(Unsent::Violation(violation)) => {
                    // The sender settles it with all others.
                    waiting.messages.pop_front();
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
            waiting.messages.pop_front();
            match self.config.role {
                Role::Server => {
                    // Nothing tells when the caller will not name the call any more.
                    self.served.sent(id);
                    self.served.released(id);
                }
                _ => self.placed.sent(id),
            }
        }
        Ok(bell)
    }

    /// What a look into the incoming ring brought, and what that means for calls.
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
            (Role::Caller, None) if self.state.is_err() => {
                // What a server that does not know of the end puts there now is too late.
                if let Some(receiver) = receiver_of(&mut self.ring) {
                    receiver.end(true);
                }
                self.fail_calls();
            }
            _ => {}
        }
        Ok(())
    }

    /// Whether replies of a link that is over can still be taken.
    //= SM2-RNG-011
    pub(in crate::link) fn may_bring_replies(&self) -> bool {
        let receiver = self.ring_receiver().filter(|_| !self.is_ring_awaited());
        self.config.role == Role::Caller && receiver.is_some_and(|it| !it.is_over())
    }

    /// The link is over: calls without a reply fail, if none can come any more.
    //= SM2-SRV-005
    pub(in crate::link) fn fail_calls(&mut self) {
        if !self.may_bring_replies() {
            let failed = self.placed.end();
            (self.events).extend(failed.map(|call| Output::CallFailed { call }));
        }
    }
}
