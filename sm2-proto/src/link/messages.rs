//! Sending, taking and releasing messages, with the same methods on both lanes.
//!
//! A message is stored once on its way to the program: `take_with` passes it to a closure of the driver, which puts it
//! where the program's call finds it. Each layer that returned the message instead would copy it.

mod calls;
mod ring;

use super::{
    At, CellMessage, CellView, Delivery, Error, Fate, Link, LinkMemory, Misuse, NoDelivery,
    OutboundMessage, Output, RingMemory, RingMessage, Role, Wake, lane::Lane, machine::Over,
    socket_lane::SocketLane, wire::Given,
};
use crate::limits::MESSAGE_MAX;

impl Link {
    /// Sends a message: DATA, REQUEST or REPLY, depending on the role. Returns whether the other
    /// end has to be woken. The ring lane passes the messages that it settles during this call to
    /// `settled`. The socket lane reports them by [`Output::Settled`].
    ///
    /// # Errors
    /// [`Error::Misuse`]: nothing was sent. [`Misuse::NotAccepted`] occurs if the message is longer
    /// than [`peer_max_len`](Self::peer_max_len). [`Misuse::NoRoom`] occurs on reliable links, and on the
    /// ring lane while a packet is blocked. [`Error::Ended`]: the link is over. If it was over
    /// before the call, nothing was sent. Otherwise this call ended the link, because the receiver
    /// violated SPEC or has stopped (SM2-RNG-010), and the outputs settle this message too.
    #[inline]
    pub fn send(
        &mut self,
        memory: &impl LinkMemory,
        message: OutboundMessage,
        mut settled: impl FnMut(u64, Fate),
    ) -> Result<Wake, Error> {
        self.check_send(message.len)?;
        let result = match &self.lane {
            Lane::Undecided => Err(Misuse::NotOpen.into()),
            Lane::Socket(_) => match self.send_by_socket(message) {
                Ok(()) => Ok(Wake::NotNeeded),
                Err(misuse) => Err(misuse.into()),
            },
            Lane::Ring(_) => match RingMessage::of(&message) {
                Some(message) => self.send_by_ring(memory, &message, &mut settled),
                None if memory.outgoing().is_none() => Err(Misuse::NotLent.into()),
                None => Err(Misuse::NotPooled.into()),
            },
        };
        self.invariants();
        result
    }

    /// As [`send`](Self::send), for a message that is in a slot, on the ring lane.
    ///
    /// # Errors
    /// Those of [`send`](Self::send). [`Misuse::NotOpen`] also occurs on the socket lane.
    #[inline]
    pub fn send_in_slot(
        &mut self,
        memory: &impl LinkMemory,
        message: &RingMessage,
        mut settled: impl FnMut(u64, Fate),
    ) -> Result<Wake, Error> {
        self.check_send(message.len)?;
        let result = self.send_by_ring(memory, message, &mut settled);
        self.invariants();
        result
    }

    /// Sends a short message in a cell of the ring, which needs no slot. Its fate is counted, but not passed to
    /// `settled`, which gets those of the messages in slots that the call settles.
    ///
    /// # Errors
    /// Those of [`send_in_slot`](Self::send_in_slot). [`Misuse::NotPooled`]: the messages of this link have a
    /// [lifespan](super::Config::lifespan), so a receiver has to give them back. [`Misuse::NoRoom`] also occurs on
    /// links of services: a request or reply that finds no room is sent in a slot, and waits in the machine.
    //= SM2-RNG-013
    #[inline]
    pub fn send_in_cell(
        &mut self,
        memory: &impl LinkMemory,
        message: &CellMessage<'_>,
        mut settled: impl FnMut(u64, Fate),
    ) -> Result<Wake, Error> {
        self.check_send(message.bytes.len() as u64)?;
        let result = self.send_by_cell(memory, message, &mut settled);
        self.invariants();
        result
    }

    /// Checks what does not depend on the lane.
    //= SM2-QOS-008, SM2-SRV-006, SM2-SRV-007
    #[inline]
    fn check_send(&self, len: u64) -> Result<(), Error> {
        if let Some(end) = self.end() {
            return Err(Error::Ended(end));
        }
        if !self.config.role.sends() {
            return Err(Misuse::WrongRole.into());
        }
        if len > self.peer_max_len && len <= MESSAGE_MAX {
            return Err(Misuse::NotAccepted.into());
        }
        Ok(())
    }

    fn send_by_socket(&mut self, message: OutboundMessage) -> Result<(), Misuse> {
        let Lane::Socket(SocketLane { outbound, .. }) = &mut self.lane else {
            return Err(Misuse::NotOpen);
        };
        match self.config.role {
            Role::Sender => {}
            Role::Receiver => return Err(Misuse::WrongRole),
            Role::Caller => self.placed.check()?,
            Role::Server => self.served.check(message.id)?,
        }
        outbound.check(&message)?;
        let id = message.id;
        let displaced = outbound.send(message)?;
        match self.config.role {
            Role::Sender | Role::Receiver => {}
            Role::Caller => self.placed.place(id),
            Role::Server => self.served.reply(id),
        }
        if let Some(key) = displaced {
            self.events.push_back(Output::Settled {
                key,
                fate: Fate::Overwritten,
            });
        }
        Ok(())
    }

    /// Settles the messages that the receiver gave back, and sends queued messages while there is
    /// room. Returns whether the receiver has to be woken. On the socket lane this call does
    /// nothing, because `handle` and `poll` do both.
    ///
    /// # Errors
    /// The same as those of [`send`](Self::send).
    #[inline]
    pub fn harvest(
        &mut self,
        memory: &impl LinkMemory,
        mut settled: impl FnMut(u64, Fate),
    ) -> Result<Wake, Error> {
        if let Some(end) = self.end() {
            return Err(Error::Ended(end));
        }
        match &self.lane {
            Lane::Ring(ring) if ring.sender().is_some() => {
                let words = memory.outgoing().ok_or(Misuse::NotLent)?;
                self.harvest_ring(words, &mut settled)
            }
            Lane::Undecided | Lane::Socket(_) | Lane::Ring(_) => Ok(Wake::NotNeeded),
        }
    }

    /// Settles the messages that the receiver gave back, and sends nothing. On the ring lane, a
    /// driver calls this after it has read a datagram or the end of the stream, and before it feeds
    /// that to the machine: the input may end the link, and messages that came back before the end
    /// count as delivered.
    ///
    /// # Errors
    /// [`Error::Misuse`]: the ring was not lent. [`Error::Ended`]: the link is over, perhaps by a
    /// violation that this call found.
    //= SM2-RNG-010, SM2-QOS-006
    pub fn settle_returned(
        &mut self,
        memory: &impl LinkMemory,
        mut settled: impl FnMut(u64, Fate),
    ) -> Result<(), Error> {
        if let Some(end) = self.end() {
            return Err(Error::Ended(end));
        }
        match &mut self.lane {
            Lane::Undecided | Lane::Socket(_) => Ok(()),
            Lane::Ring(ring) => {
                let Some(sender) = ring.sender_mut() else {
                    return Ok(());
                };
                let words = memory.outgoing().ok_or(Misuse::NotLent)?;
                let harvested = sender.harvest(words, &mut settled);
                let result = harvested.map_err(|violation| self.violated(violation));
                self.invariants();
                result
            }
        }
    }

    /// Whether one more message could be sent without displacing another message and without being
    /// refused for lack of room or for too many calls.
    #[inline]
    pub fn has_room(&self, memory: &impl LinkMemory) -> bool {
        if self.state.is_err() || !self.config.role.sends() {
            return false;
        }
        match &self.lane {
            Lane::Undecided => false,
            Lane::Socket(socket) => self.placed.check().is_ok() && socket.outbound.has_room(),
            Lane::Ring(ring) => match (ring.sender(), memory.outgoing()) {
                (Some(_), Some(_)) if self.has_calls() => self.placed.check().is_ok(),
                (Some(sender), Some(words)) => !self.blocked && sender.has_room(words),
                _ => false,
            },
        }
    }

    /// Takes the oldest message for the application; `None` if none is ready. The application holds
    /// the message until [`release`](Self::release).
    ///
    /// # Errors
    /// See [`NoDelivery`].
    #[inline]
    pub fn take(&mut self, memory: &impl LinkMemory) -> Result<Option<Delivery>, NoDelivery> {
        self.take_with(memory, |delivery| delivery.map_cell(CellView::to_bytes))
    }

    /// As [`take`](Self::take), but passes the message to `deliver` and returns its result. A driver
    /// that stores the message there saves copies of it.
    ///
    /// # Errors
    /// See [`NoDelivery`].
    #[inline]
    pub fn take_with<R>(
        &mut self,
        memory: &impl LinkMemory,
        deliver: impl FnOnce(Delivery<CellView<'_>>) -> R,
    ) -> Result<Option<R>, NoDelivery> {
        match &mut self.lane {
            Lane::Ring(_) => self.take_from_ring(memory, deliver),
            _ if !self.config.role.receives() => Err(NoDelivery::Misuse(Misuse::WrongRole)),
            Lane::Undecided => Ok(None),
            Lane::Socket(socket) => {
                let taken = socket.inbound.take().map_err(NoDelivery::TooManyBorrowed);
                self.invariants();
                taken.map(|it| it.map(|it| deliver(it.map_cell(|never| match never {}))))
            }
        }
    }

    /// Prefetches the message that [`take`](Self::take) would return now, on the ring lane.
    #[inline]
    pub fn prefetch(&self, memory: &impl LinkMemory) {
        self.prefetch_from_ring(memory);
    }

    /// Whether [`take`](Self::take) may return a message.
    #[inline]
    pub fn may_take(&self, memory: &impl LinkMemory) -> bool {
        match &self.lane {
            Lane::Undecided => false,
            Lane::Socket(socket) => socket.inbound.untaken() > 0,
            Lane::Ring(ring) => match (&ring.incoming, memory.incoming()) {
                (Some(receiver), Some(words)) => !ring.is_awaited() && receiver.may_take(words),
                _ => false,
            },
        }
    }

    /// The word of the incoming ring that the next message fills, on a live link on the ring lane. A thread that spins
    /// can watch this word without the machine. Once it is not [`EMPTY`](super::EMPTY), [`take`](Self::take) may return
    /// a message; another call of the machine changes the word.
    #[must_use]
    #[inline]
    pub const fn next_word(&self) -> Option<At> {
        match &self.lane {
            Lane::Ring(ring) if !ring.is_awaited() => match &ring.incoming {
                Some(receiver) => receiver.next_word(),
                None => None,
            },
            _ => None,
        }
    }

    /// An upper bound for the number of messages that wait for [`take`](Self::take).
    #[inline]
    pub fn untaken(&self, memory: &impl LinkMemory) -> usize {
        match &self.lane {
            Lane::Undecided => 0,
            Lane::Socket(socket) => socket.inbound.untaken(),
            Lane::Ring(ring) => match (&ring.incoming, memory.incoming()) {
                (Some(receiver), Some(words)) => receiver.untaken(words),
                _ => 0,
            },
        }
    }

    /// Gives back the message with this [`Delivery::sequence`]. Returns whether the sender has to
    /// be woken.
    ///
    /// # Errors
    /// [`Error::Misuse`]: the application does not hold the message. [`Error::Ended`]: the link is
    /// over, perhaps by a violation that this call found. A release after the end still makes room
    /// for [`take`](Self::take), although it returns this error.
    #[inline]
    pub fn release(&mut self, memory: &impl LinkMemory, sequence: u64) -> Result<Wake, Error> {
        self.release_all(memory, [sequence])
    }

    /// Gives back several messages in this order, as [`release`](Self::release) gives back one. On
    /// the ring lane they are one batch, with one fence: see SM2-RNG-012.
    ///
    /// # Errors
    /// That of the first message that has one. The other messages are given back all the same, but the
    /// sender is not woken for them.
    #[inline]
    pub fn release_all(
        &mut self,
        memory: &impl LinkMemory,
        sequences: impl IntoIterator<Item = u64>,
    ) -> Result<Wake, Error> {
        self.give_back(memory, sequences, Given::Consumed)
    }

    /// Gives back a message that [`take`](Self::take) returned and that [has expired](Self::is_expired), so that the
    /// application does not see it. Returns whether the sender has to be woken.
    ///
    /// # Errors
    /// As [`release`](Self::release).
    //= SM2-QOS-010
    pub fn expire<C>(
        &mut self,
        memory: &impl LinkMemory,
        delivery: &Delivery<C>,
    ) -> Result<Wake, Error> {
        self.give_back(memory, [delivery.sequence], Given::Expired)
    }

    /// Gives messages back that the application has consumed, or that have expired.
    #[inline]
    pub(super) fn give_back(
        &mut self,
        memory: &impl LinkMemory,
        sequences: impl IntoIterator<Item = u64>,
        given: Given,
    ) -> Result<Wake, Error> {
        match &self.lane {
            Lane::Ring(_) => self.release_to_ring(memory, sequences, given),
            Lane::Undecided | Lane::Socket(_) => (sequences.into_iter())
                .map(|sequence| self.release_by_socket(sequence, given))
                .fold(Ok(Wake::NotNeeded), Result::and),
        }
    }

    fn release_by_socket(&mut self, sequence: u64, given: Given) -> Result<Wake, Error> {
        let result = match &mut self.lane {
            Lane::Ring(_) => Err(Misuse::NotOpen.into()),
            Lane::Undecided => match self.state {
                Ok(_) => Err(Misuse::NotOpen.into()),
                Err(Over { end, .. }) => Err(Error::Ended(end)),
            },
            Lane::Socket(socket) => match self.state {
                Ok(_) if !self.config.role.receives() => Err(Misuse::WrongRole.into()),
                Ok(_) if socket.inbound.release(sequence, given) => Ok(Wake::NotNeeded),
                Ok(_) => Err(Misuse::NotBorrowed.into()),
                Err(Over { end, .. }) => {
                    socket.inbound.forget(sequence);
                    Err(Error::Ended(end))
                }
            },
        };
        self.invariants();
        result
    }

    /// Announces that this end is about to sleep until its socket is readable. The driver looks for
    /// messages or room once more before it sleeps.
    //= SM2-RNG-012
    #[inline]
    pub fn park(&self, memory: &impl LinkMemory) {
        if let Some((words, parked)) = self.parked_word(memory) {
            words.swap(parked, 1);
            // Pairs with the SeqCst fence in `wake_parked`. The other end puts a word, and then
            // checks our parked word. Either it sees that we parked, or our next look sees its
            // word.
            words.fence();
        }
    }

    /// Announces that no thread of this end sleeps any more.
    #[inline]
    pub fn unpark(&self, memory: &impl LinkMemory) {
        if let Some((words, parked)) = self.parked_word(memory) {
            words.swap(parked, 0);
        }
    }

    fn parked_word<'m, M: LinkMemory>(&self, memory: &'m M) -> Option<(&'m M::Ring, At)> {
        let Lane::Ring(ring) = &self.lane else {
            return None;
        };
        let parked = ring.parked_word()?;
        let words = match parked {
            At::SenderParked => memory.outgoing(),
            At::ReceiverParked | At::Forward(_) | At::Back(_) => memory.incoming(),
        };
        Some((words?, parked))
    }
}
