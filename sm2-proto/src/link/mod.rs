//! One end of a link: SPEC sections 6 to 9, for all four roles.
//!
//! | to do | call |
//! | --- | --- |
//! | feed | [`Link::handle`] with each datagram, each wish of the application, each change of the socket |
//! | drain | [`Link::poll`] until it gives nothing, after every feed |
//! | messages | [`Link::send`], [`Link::take`], [`Link::release`], [`Link::has_room`], the same on both lanes: see [`lane`] |
//! | deadline | [`Link::deadline`]: a link has no timer in version 1 |
//! | inspect | [`Link::is_open`], [`Link::end`], [`Link::counters`], … |
//!
//! The machine never does I/O, reads no clock and sees no descriptor. Its driver
//! owns the socket, the mappings and the payloads; one place in the driver
//! matches [`Output`].
//!
//! * A datagram is handled and then drained before the next one:
//!   [`Output::Attach`] and [`Output::Keep`] speak of the descriptor of *the
//!   datagram just handled*, and what no output asks for is closed.
//!   [`Input::Datagram`] and [`Input::Send`] are refused until that is done.
//! * A packet that the socket does not take stays with the driver, which says
//!   [`Input::Blocked`]; all else stays here, where keep-last can still displace
//!   it, until [`Input::Writable`].
//! * Each [`Input::Send`] that was taken comes back as one [`Output::Settled`].
//!   Until then the driver leaves the payload alone.
//! * The first reason to end is the last: whatever is fed after it is answered
//!   with [`Error::Ended`] and that reason. Before [`Output::Ended`], everything that is not
//!   settled is, and a CLOSE goes out if one is due and the socket is not blocked.
//!   Messages that were ready can still be taken, and a taken one still has to be
//!   released before another can be taken in its stead; nothing of it is sent.
//!   A sender must not write again to slots that were settled as [`Fate::Closed`] (SM2-OPN-008).
//!
//! Whoever embeds this without `sm2-node` finds all that it needs here and in
//! [`wire`]; which links there are is the business of [`node`](crate::node).

mod attachments;
mod calls;
mod config;
mod frame_kind;
#[cfg(any(test, feature = "fuzzing"))]
pub(crate) mod fuzz;
mod inbound;
pub mod lane;
mod outbound;
mod packet;
mod phase;
#[cfg(any(kani, test))]
mod proofs;
mod receive;
mod ring;
mod role;
mod segments;
mod socket_lane;
mod status;
mod types;
pub mod wire;

use alloc::collections::VecDeque;

use self::{
    calls::{Placed, Served},
    inbound::Inbound,
    outbound::{Outbound, Sent},
    phase::Phase,
    ring::{Ring, RingSender},
    wire::{Frame, LANE_RING, LANE_SOCKET, Open},
};
pub use self::{
    config::Config,
    frame_kind::FrameKind,
    lane::{Lent, LinkMemory, NoDelivery, NoMemory},
    packet::{Attachment, Head, Packet},
    ring::{At, EMPTY, NotAWord, RingLayout, RingMemory, SlotHead, Word, doorbell},
    role::Role,
    segments::SegmentInfo,
    status::Status,
    types::{
        Body, Counters, Delivery, End, Error, Fate, Input, Misuse, OutboundMessage, Output,
        Payload, TooManyBorrowed,
    },
};
use crate::{Code, Instant, Violation};

/// One end of one link. The module's page says in which order to call what.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Link {
    config: Config,
    /// Where it stands, or why it is over.
    state: Result<Phase, End>,
    /// Whether our OPEN was handed out.
    greeted: bool,
    /// Whether the driver keeps a packet.
    blocked: bool,
    /// The code of a CLOSE that has to be handed out.
    farewell: Option<Code>,
    /// All outputs but those to transmit, which are made when they are polled.
    events: VecDeque<Output>,
    outbound: Outbound,
    inbound: Inbound,
    placed: Placed,
    served: Served,
    /// Where its messages are, if both ends offered the ring lane.
    ring: Option<Ring>,
    /// Whether RING has to be handed out.
    announce_ring: bool,
    /// Segments whose DETACHED has to be handed out.
    detached: VecDeque<u32>,
}

impl Link {
    /// A new end; its first output is the packet with OPEN.
    ///
    /// A `depth` or `max_borrowed` out of range is brought into it, and links of
    /// services are reliable whatever `config` says.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let config = config.in_range();
        Self {
            config,
            state: Ok(Phase::Opening),
            greeted: false,
            blocked: false,
            farewell: None,
            events: VecDeque::new(),
            outbound: Outbound::new(&config),
            inbound: Inbound::new(&config),
            placed: Placed::default(),
            served: Served::default(),
            ring: None,
            announce_ring: false,
            detached: VecDeque::new(),
        }
    }

    /// Feeds what has happened. `now` is not used in version 1.
    ///
    /// # Errors
    /// [`Error::Misuse`]: the input was not one that may come now; nothing has
    /// changed. [`Error::Ended`]: the link is over, perhaps by a violation in
    /// this very input; the outputs say the rest. After the end,
    /// [`Input::Release`] still makes room for [`Link::take`], although it is
    /// answered like all else.
    pub fn handle(&mut self, _now: Instant, input: Input<'_>) -> Result<(), Error> {
        let result = match self.state {
            Ok(phase) => self.handle_live(phase, input),
            Err(end) => {
                self.handle_ended(&input);
                Err(Error::Ended(end))
            }
        };
        self.invariants();
        result
    }

    fn handle_live(&mut self, phase: Phase, input: Input<'_>) -> Result<(), Error> {
        match input {
            Input::Datagram(datagram) => {
                self.check_drained()?;
                //= SM2-TRN-003
                if datagram.bytes.is_empty() {
                    self.finish(End::Eof);
                    return Ok(());
                }
                self.receive(phase, &datagram)
                    .map_err(|violation| self.violated(violation))?;
            }
            Input::Eof => self.finish(End::Eof),
            Input::Send(message) => self.send_by_socket(message)?,
            Input::Skip => self.skip()?,
            Input::PassOver => self.pass_over()?,
            Input::SegmentMissing => {
                self.on_segment_missing();
                if let Err(end) = self.state {
                    return Err(Error::Ended(end));
                }
            }
            Input::Release { sequence } => self.release_live(sequence)?,
            Input::Cancel { call } => self.cancel(call)?,
            Input::Attach(segment) => self.attach(&segment)?,
            Input::Retire { segment } => self.retire(segment)?,
            Input::Blocked => self.blocked = true,
            Input::Writable => self.blocked = false,
            Input::Close(code) => self.finish(End::Local(code)),
        }
        Ok(())
    }

    fn handle_ended(&mut self, input: &Input<'_>) {
        match input {
            Input::Release { sequence } => self.inbound.forget(*sequence),
            Input::SegmentMissing => self.on_segment_missing(),
            Input::Blocked => self.farewell = None,
            _ => {}
        }
    }

    fn check_drained(&self) -> Result<(), Misuse> {
        if self.events.is_empty() {
            Ok(())
        } else {
            Err(Misuse::Undrained)
        }
    }

    fn skip(&mut self) -> Result<(), Misuse> {
        if self.config.role != Role::Sender || !self.config.reliable {
            return Err(Misuse::WrongRole);
        }
        if let Some(sender) = ring::sender_of(&mut self.ring) {
            sender.skip(Fate::Deadline);
            return Ok(());
        }
        self.outbound.skip()
    }

    fn cancel(&mut self, call: u64) -> Result<(), Misuse> {
        if self.config.role != Role::Caller {
            return Err(Misuse::WrongRole);
        }
        let last = match &self.ring {
            Some(ring) => ring.last_id(),
            None => self.outbound.last_id(),
        };
        self.placed.cancel(call, last)
    }

    fn retire(&mut self, segment: u32) -> Result<(), Misuse> {
        if !self.config.role.sends() {
            return Err(Misuse::WrongRole);
        }
        match ring::sender_of(&mut self.ring) {
            Some(sender) => sender.retire(segment),
            None => self.outbound.retire(segment),
        }
    }

    fn attach(&mut self, segment: &SegmentInfo) -> Result<(), Misuse> {
        match ring::sender_of(&mut self.ring) {
            Some(sender) => sender.attach(segment),
            None => Err(Misuse::WrongLane),
        }
    }

    /// The one place where a link breaks off.
    //= SM2-OPN-006
    fn violated(&mut self, violation: Violation) -> Error {
        let end = End::Violation(violation);
        self.finish(end);
        Error::Ended(end)
    }

    /// The one place where a link ends.
    //= SM2-OPN-005, SM2-OPN-006, SM2-OPN-007, SM2-SRV-005
    fn finish(&mut self, end: End) {
        self.state = Err(end);
        let code = match end {
            End::Local(code) => Some(code),
            End::Violation(violation) => Some(violation.code()),
            End::Peer(_) | End::Eof => None,
        };
        self.farewell = code.filter(|_| !self.blocked);
        let events = &mut self.events;
        let mut settle = |key| {
            events.push_back(Output::Settled {
                key,
                fate: Fate::Closed,
            });
        };
        self.outbound.end(&mut settle);
        if let Some(ring) = &mut self.ring {
            ring.end(matches!(end, End::Violation(_)), &mut settle);
        }
        self.fail_calls();
        self.served.end();
        self.inbound.end(self.ring.is_some());
        self.events.push_back(Output::Ended(end));
    }

    /// The next thing to do; call it until it gives nothing.
    pub fn poll(&mut self) -> Option<Output> {
        let output = self.next_output();
        self.invariants();
        output
    }

    fn next_output(&mut self) -> Option<Output> {
        if let Some(code) = self.farewell.take() {
            return Some(Output::Transmit(Packet::bare(Frame::Close(code).head())));
        }
        if let Some(event) = self.events.pop_front() {
            return Some(event);
        }
        if self.blocked || self.state.is_err() {
            return None;
        }
        self.transmit().map(Output::Transmit)
    }

    /// The next frame, made of what is there at this moment: OPEN before all
    /// else, what gives back before what asks.
    //= SM2-OPN-001
    fn transmit(&mut self) -> Option<Packet> {
        if !self.greeted {
            self.greeted = true;
            return Some(Packet::bare(self.open().head()));
        }
        if let Some(packet) = self.transmit_ring() {
            return Some(packet);
        }
        if let Some(release) = self.inbound.poll() {
            return Some(release);
        }
        if let Some(call) = self.placed.poll() {
            return Some(Packet::bare(Frame::Cancel { call }.head()));
        }
        let Sent { packet, id } = self.outbound.poll()?;
        match (self.config.role, id) {
            (Role::Caller, Some(call)) => self.placed.sent(call),
            (Role::Server, Some(call)) => self.served.sent(call),
            _ => {}
        }
        Some(packet)
    }

    /// Our OPEN.
    //= SM2-OPN-002, SM2-OPN-003, SM2-OPN-004, SM2-RNG-001
    fn open(&self) -> Frame<'static> {
        Frame::Open(Open {
            role: self.config.role as u8,
            version: self.config.version,
            window: self.config.window(),
            link: self.config.id,
            lanes: LANE_SOCKET | if self.config.ring { LANE_RING } else { 0 },
        })
    }

    /// Whether [`Link::poll`] may have something: not, if it surely has nothing. After a message on
    /// the ring lane there mostly is nothing to drain.
    #[must_use]
    #[inline]
    pub fn has_output(&self) -> bool {
        match &self.ring {
            Some(ring) if self.greeted && self.state.is_ok() => {
                !self.events.is_empty()
                    || self.announce_ring
                    || !self.detached.is_empty()
                    || self.placed.has_cancels()
                    || ring.sender().is_some_and(RingSender::has_steps)
            }
            _ => true,
        }
    }

    /// When to call [`Link::handle`] at the latest: never in version 1.
    #[must_use]
    pub const fn deadline(&self) -> Option<Instant> {
        None
    }

    /// Whether both OPEN were exchanged, and RING where the link has one, and the link is not over.
    #[must_use]
    #[inline]
    pub fn is_open(&self) -> bool {
        self.state == Ok(Phase::Open) && !self.is_ring_awaited()
    }

    /// Why the link is over, if it is.
    #[must_use]
    #[inline]
    pub fn end(&self) -> Option<End> {
        self.state.err()
    }

    /// The terms of this end.
    #[must_use]
    #[inline]
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// What became of the messages that this end was given to send.
    #[must_use]
    #[inline]
    pub fn counters(&self) -> Counters {
        match &self.ring {
            Some(ring) => ring.counters(),
            None => self.outbound.counters(),
        }
    }

    /// Whether a deadline passed ([`Input::Skip`]) and the other end has
    /// released nothing since: such a link is not waited for (SM2-QOS-002).
    #[must_use]
    #[inline]
    pub fn is_stalled(&self) -> bool {
        match &self.ring {
            Some(ring) => ring.sender().is_some_and(RingSender::is_stalled),
            None => self.outbound.is_stalled(),
        }
    }

    /// How many messages of this end are not settled.
    #[must_use]
    pub fn in_flight(&self) -> usize {
        match &self.ring {
            Some(ring) => ring.in_flight(),
            None => self.outbound.in_flight(),
        }
    }

    /// How many calls have no reply: of a caller those that it made, also after
    /// the end as long as [`Link::take`] may bring their replies; of a
    /// server those that it took and whose reply has not left.
    #[must_use]
    pub fn calls(&self) -> usize {
        self.placed.len() + self.served.len()
    }

    /// What must hold between any two calls. Free in release.
    #[inline]
    fn invariants(&self) {
        if cfg!(debug_assertions) {
            self.outbound.invariants();
            self.inbound.invariants();
            self.placed.invariants();
            self.served.invariants();
            if let Some(ring) = &self.ring {
                ring.invariants();
            }
            let is_over = self.state.is_err();
            debug_assert!(is_over || self.farewell.is_none());
            debug_assert!(!is_over || self.in_flight() == 0);
            debug_assert!(!is_over || self.calls() == 0 || self.may_bring_replies());
        }
    }
}
