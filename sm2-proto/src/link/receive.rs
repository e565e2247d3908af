//! Handling of received datagrams: the checks of SPEC section 10 in their order, and their effects.

#[cfg(any(kani, test))]
mod proofs;

use super::{
    Carrier, End, Fate, Link, MaxLen, Output, Role, SegmentInfo,
    lane::Lane,
    outbound::Released,
    phase::{self, Phase},
    ring::RingLane,
    segments::Verified,
    socket_lane::SocketLane,
    wire::{Frame, Given, LANE_RING, LANE_SOCKET, MessageFrame, Open},
};
use crate::{
    Datagram, Farewell, FdFacts, Instant, Violation,
    limits::{MESSAGE_MAX, WINDOW_MAX},
};

/// A frame of the other lane. Defensive: [`phase::check_kind`] has already refused such a frame.
const WRONG_LANE: Violation = violation!(WrongLane, "SM2-RNG-001");

impl Link {
    /// Handles one datagram. A frame that violates SPEC has no other effect than the violation.
    pub(super) fn receive(
        &mut self,
        now: Instant,
        phase: Phase,
        datagram: &Datagram<'_>,
    ) -> Result<(), Violation> {
        let frame = Frame::decode(datagram)?;
        //= SM2-RNG-001
        let is_ring = match frame {
            Frame::Ring { .. } => self.peer_offers_ring,
            _ => matches!(self.lane, Lane::Ring(_)),
        };
        phase::check_kind(phase, self.config.role, is_ring, frame.kind())?;
        //= SM2-TRN-011
        if datagram.has_lost_fds(frame.fds()) {
            self.finish(End::Local(Farewell::Resources.code()));
            return Ok(());
        }
        frame.check_length()?;
        match frame {
            Frame::Open(open) => self.on_open(&open),
            Frame::Attach(segment) => self.on_attach(segment, datagram.fds),
            Frame::Detach { segment } => self.on_detach(segment),
            Frame::Message(message) => self.on_message(&message, datagram.fds),
            Frame::Release { given, .. } => self.on_release(&frame, given),
            Frame::Cancel { call } => self.on_cancel(call),
            Frame::Ring { depth, window } => self.on_ring(depth, window, datagram.fds),
            // DOORBELL has no content: the driver checks the ring after each wake-up.
            Frame::Doorbell => Ok(()),
            Frame::Detached { segment } => self.on_detached(segment),
            Frame::Alive { time } => self.qos_timers.on_alive(&self.config, time, now),
            //= SM2-OPN-007, SM2-COD-001
            Frame::Close(code) => {
                self.finish(End::Peer(code));
                Ok(())
            }
        }
    }

    //= SM2-OPN-002, SM2-OPN-003, SM2-OPN-004, SM2-OPN-005, SM2-OPN-006
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
        let peer_max_len = match (config.role, MaxLen::from_units(open.max_len)) {
            (Role::Receiver, None) if open.max_len == 0 => MESSAGE_MAX,
            (Role::Sender | Role::Caller | Role::Server, Some(max_len)) => max_len.bytes(),
            _ => return Err(violation!(BadOpen, "SM2-OPN-005")),
        };
        if !open.publications.is_legal(config.role == Role::Receiver) {
            return Err(violation!(BadOpen, "SM2-OPN-006"));
        }
        self.peer_max_len = peer_max_len;
        self.peer_publications = open.publications;
        self.state = Ok(Phase::Open);
        self.peer_offers_ring = !config.sealed && open.lanes & LANE_RING != 0;
        self.open_lane(open);
        self.events.push_back(Output::Opened);
        Ok(())
    }

    /// Chooses the lane, which is known once the other end's OPEN has come.
    //= SM2-RNG-001
    fn open_lane(&mut self, open: &Open) {
        if self.config.ring && self.peer_offers_ring {
            self.lane = Lane::Ring(RingLane::new(&self.config, open.window));
            return;
        }
        let unused_ring = self.peer_offers_ring.then_some(open.window);
        if let Lane::Socket(socket) = &mut self.lane {
            socket.unused_ring = unused_ring;
            let (placed, events) = (&mut self.placed, &mut self.events);
            return socket
                .outbound
                .open(open.window, self.peer_max_len, |message| {
                    let (key, call) = (message.key, message.id);
                    let fate = Fate::TooLong;
                    events.push_back(Output::Settled { key, fate });
                    //= SM2-SRV-006
                    if self.config.role == Role::Caller {
                        placed.replied(call);
                        events.push_back(Output::CallFailed { call });
                    }
                });
        }
        let mut socket = SocketLane::new(&self.config);
        socket.unused_ring = unused_ring;
        socket.outbound.open(open.window, self.peer_max_len, |_| {});
        self.lane = Lane::Socket(socket);
    }

    fn on_attach(&mut self, info: SegmentInfo, fds: &[FdFacts]) -> Result<(), Violation> {
        match &mut self.lane {
            Lane::Undecided => return Err(violation!(ExpectedOpen, "SM2-OPN-001")),
            Lane::Socket(socket) => socket.inbound.attach(&info, fds)?,
            Lane::Ring(ring) => ring.segments.attach(&info, fds)?,
        }
        let SegmentInfo { id, stride, slots } = info;
        self.events.push_back(Output::Attach {
            segment: id,
            stride,
            slots,
        });
        Ok(())
    }

    fn on_detach(&mut self, segment: u32) -> Result<(), Violation> {
        match &mut self.lane {
            Lane::Undecided => return Err(violation!(ExpectedOpen, "SM2-OPN-001")),
            Lane::Socket(socket) => socket.inbound.detach(segment)?,
            Lane::Ring(ring) => ring.on_detach(segment)?,
        }
        self.events.push_back(Output::Detach { segment });
        Ok(())
    }

    fn on_message(&mut self, message: &MessageFrame<'_>, fds: &[FdFacts]) -> Result<(), Violation> {
        let Lane::Socket(SocketLane { inbound, .. }) = &mut self.lane else {
            return Err(WRONG_LANE);
        };
        let checked = inbound.check(message, fds)?;
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
        if checked.is_sealed() {
            self.events.push_back(Output::Keep {
                sequence: checked.sequence(),
            });
        }
        if let Some(sequence) = inbound.accept(checked) {
            self.events.push_back(Output::Discard { sequence });
        }
        Ok(())
    }

    fn on_release(&mut self, frame: &Frame<'_>, given: Given) -> Result<(), Violation> {
        let Self {
            lane: Lane::Socket(SocketLane { outbound, .. }),
            served,
            events,
            ..
        } = self
        else {
            return Err(WRONG_LANE);
        };
        outbound.release(frame, given, |Released { key, id, fate }| {
            served.released(id);
            events.push_back(Output::Settled { key, fate });
        })
    }

    fn on_ring(&mut self, depth: u16, window: u32, fds: &[FdFacts]) -> Result<(), Violation> {
        let layout = Verified::ring(depth, window, fds)?;
        match &mut self.lane {
            Lane::Undecided => return Err(WRONG_LANE),
            Lane::Socket(socket) => socket.on_ring(window)?,
            Lane::Ring(ring) => {
                ring.on_ring(&self.config, layout)?;
                self.events.push_back(Output::Ring(layout));
            }
        }
        Ok(())
    }

    fn on_detached(&mut self, segment: u32) -> Result<(), Violation> {
        match &mut self.lane {
            Lane::Ring(ring) => ring.on_detached(segment),
            Lane::Undecided | Lane::Socket(_) => Err(WRONG_LANE),
        }
    }

    fn on_cancel(&mut self, call: u64) -> Result<(), Violation> {
        let is_new = match &self.lane {
            Lane::Undecided | Lane::Socket(_) => self.served.cancel(call)?,
            Lane::Ring(ring) => self.served.cancel_of_ring(call, ring.depth())?,
        };
        if is_new {
            self.events.push_back(Output::Cancelled { call });
        }
        Ok(())
    }
}
