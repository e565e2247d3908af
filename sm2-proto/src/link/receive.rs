//! From a datagram to what it changes: the checks of SPEC section 10 in their order.

use super::{
    End, Link, Output, Role, SegmentInfo,
    outbound::Released,
    phase::{self, Phase},
    wire::{Carrier, Frame, Given, LANE_RING, LANE_SOCKET, MessageFrame, Open},
};
use crate::{Datagram, FdFacts, Violation, limits::WINDOW_MAX};

impl Link {
    /// Handles one datagram. A frame that is a violation has no other effect.
    pub(super) fn receive(
        &mut self,
        phase: Phase,
        datagram: &Datagram<'_>,
    ) -> Result<(), Violation> {
        let frame = Frame::decode(datagram)?;
        phase::admit(phase, self.config.role, self.ring.is_some(), frame.kind())?;
        frame.check_length()?;
        match frame {
            Frame::Open(open) => self.on_open(&open),
            Frame::Attach(segment) => self.on_attach(segment, datagram.fds),
            Frame::Detach { segment } => self.on_detach(segment),
            Frame::Message(message) => self.on_message(&message, datagram.fds),
            Frame::Release { given, .. } => self.on_release(&frame, given),
            Frame::Cancel { call } => self.on_cancel(call),
            Frame::Ring { depth, window } => self.on_ring(depth, window, datagram.fds),
            // That it came is all that it says: the driver looks at the ring.
            Frame::Doorbell => Ok(()),
            Frame::Detached { segment } => self.on_detached(segment),
            //= SM2-OPN-005, SM2-COD-001
            Frame::Close(code) => {
                self.finish(End::Peer(code));
                Ok(())
            }
        }
    }

    //= SM2-OPN-002, SM2-OPN-003, SM2-OPN-004
    fn on_open(&mut self, open: &Open) -> Result<(), Violation> {
        let config = &self.config;
        let expected = (config.role.counterpart() as u8, config.version, config.id);
        if (open.role, open.version, open.link) != expected {
            return Err(violation!(BadOpen, "SM2-OPN-002"));
        }
        let is_legal = match config.role {
            Role::Receiver => open.window == 0,
            Role::Sender | Role::Caller | Role::Server => (1..=WINDOW_MAX).contains(&open.window),
        };
        if !is_legal {
            return Err(violation!(BadWindow, "SM2-OPN-003"));
        }
        if open.lanes & LANE_SOCKET == 0 {
            return Err(violation!(BadOpen, "SM2-OPN-004"));
        }
        self.state = Ok(Phase::Open);
        self.outbound.open(open.window);
        self.events.push_back(Output::Opened);
        if self.config.ring && open.lanes & LANE_RING != 0 {
            self.agree_on_ring(open.window);
        }
        Ok(())
    }

    fn on_attach(&mut self, info: SegmentInfo, fds: &[FdFacts]) -> Result<(), Violation> {
        self.inbound.attach(&info, fds, &self.detached)?;
        let SegmentInfo { id, stride, slots } = info;
        self.events.push_back(Output::Attach {
            segment: id,
            stride,
            slots,
        });
        Ok(())
    }

    //= SM2-RNG-010
    fn on_detach(&mut self, segment: u32) -> Result<(), Violation> {
        if self.ring_holds(segment) {
            return Err(violation!(SegmentBusy, "SM2-SEG-005"));
        }
        self.inbound.detach(segment)?;
        if self.ring.is_some() {
            self.detached.push_back(segment);
        }
        self.events.push_back(Output::Detach { segment });
        Ok(())
    }

    fn on_message(&mut self, message: &MessageFrame<'_>, fds: &[FdFacts]) -> Result<(), Violation> {
        let admitted = self.inbound.check(message, fds)?;
        match message.carrier {
            Carrier::Data => {}
            Carrier::Request => {
                self.served.check_request(message.id)?;
                self.served.requested(message.id);
            }
            Carrier::Reply => {
                self.placed
                    .check_reply(message.id, message.status, message.len)?;
                self.placed.replied(message.id);
            }
        }
        if admitted.is_sealed() {
            self.events.push_back(Output::Keep {
                sequence: admitted.sequence(),
            });
        }
        if let Some(sequence) = self.inbound.accept(admitted) {
            self.events.push_back(Output::Discard { sequence });
        }
        Ok(())
    }

    fn on_release(&mut self, frame: &Frame<'_>, given: Given) -> Result<(), Violation> {
        let Self {
            outbound,
            served,
            events,
            ..
        } = self;
        outbound.release(frame, given, |Released { key, id, fate }| {
            served.released(id);
            events.push_back(Output::Settled { key, fate });
        })
    }

    fn on_cancel(&mut self, call: u64) -> Result<(), Violation> {
        let is_new = match &self.ring {
            None => self.served.cancel(call)?,
            Some(ring) => self.served.cancel_of_ring(call, ring.depth())?,
        };
        if is_new {
            self.events.push_back(Output::Cancelled { call });
        }
        Ok(())
    }
}
