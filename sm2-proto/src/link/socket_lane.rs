//! Messages that go by the socket, and what of them the machine's contract refuses.

use super::{End, Error, Fate, Input, Link, Misuse, OutboundMessage, Output, Role, phase::Phase};
use crate::{Instant, Machine};

impl Link {
    /// [`Link::send`] on the socket lane.
    pub(super) fn send_by_socket(&mut self, message: OutboundMessage) -> Result<(), Misuse> {
        self.check_drained()?;
        if self.ring.is_some() {
            return Err(Misuse::WrongLane);
        }
        if self.may_get_ring() {
            return Err(Misuse::NoRoom);
        }
        match self.config.role {
            Role::Sender => {}
            Role::Receiver => return Err(Misuse::WrongRole),
            Role::Caller => self.placed.check()?,
            Role::Server => self.served.check(message.id)?,
        }
        self.outbound.check(&message)?;
        let id = message.id;
        let displaced = self.outbound.send(message)?;
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

    /// Whether the other end's OPEN will say on which lane the messages go: until then none can
    /// be taken, since what waits for one lane cannot leave by the other.
    //= SM2-RNG-001
    pub(super) fn may_get_ring(&self) -> bool {
        self.config.ring && self.state == Ok(Phase::Opening)
    }

    /// This publication is not sent on this link.
    pub(super) fn pass_over(&mut self) -> Result<(), Misuse> {
        if self.ring.is_some() {
            return self.pass_over_ring();
        }
        Err(Misuse::WrongLane)
    }

    /// [`Link::release`] on the socket lane.
    pub(super) fn release_by_socket(&mut self, sequence: u64) -> Result<(), Error> {
        let result = match self.state {
            Ok(_) => self.release_live(sequence).map_err(Error::Misuse),
            Err(end) => {
                self.inbound.forget(sequence);
                Err(Error::Ended(end))
            }
        };
        self.invariants();
        result
    }

    pub(super) fn release_live(&mut self, sequence: u64) -> Result<(), Misuse> {
        if !self.config.role.receives() {
            return Err(Misuse::WrongRole);
        }
        if self.inbound.release(sequence) {
            Ok(())
        } else {
            Err(Misuse::NotBorrowed)
        }
    }

    /// [`Link::has_room`] on the socket lane.
    pub(super) fn has_room_by_socket(&self) -> bool {
        self.state.is_ok()
            && !self.may_get_ring()
            && self.config.role.sends()
            && self.placed.check().is_ok()
            && self.outbound.has_room()
    }
}

/// Each datagram is fed with its outputs drained, else [`Misuse::Undrained`] refuses it. These inputs
/// may come while outputs wait: [`Input::Blocked`], which reports on the packet just polled, and all
/// others that do not speak of a descriptor.
impl Machine for Link {
    type Input<'a> = Input<'a>;
    type Output = Output;
    type End = End;
    type Misuse = Misuse;

    fn handle(&mut self, now: Instant, input: Input<'_>) -> Result<(), Error> {
        Self::handle(self, now, input)
    }

    fn poll(&mut self) -> Option<Output> {
        Self::poll(self)
    }

    fn deadline(&self) -> Option<Instant> {
        Self::deadline(self)
    }
}
