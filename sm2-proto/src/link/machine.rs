//! The state of one end of a link, and its transitions.

use alloc::collections::VecDeque;

use super::{
    Attachment, Config, End, Error, Fate, Input, Misuse, Output, Packet, Publications, Role,
    SegmentInfo,
    calls::{Placed, Served},
    lane::Lane,
    outbound::OutboundFrame,
    phase::Phase,
    qos::QosTimers,
    segments::Geometry,
    wire::{Frame, LANE_RING, LANE_SOCKET, Open},
};
use crate::{
    Code, Instant, Machine, Period, Violation, limits::MESSAGE_MAX, machine::debug_assert_drained,
};

/// One end of one link. The [documentation of the module](crate::link) gives the order of calls of
/// its methods.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Link {
    pub(super) config: Config,
    pub(super) state: Result<Phase, Over>,
    /// Whether `poll` has returned our OPEN.
    pub(super) open_sent: bool,
    /// Whether `poll` has to return our RING, after OPEN.
    pub(super) ring_due: bool,
    /// Whether the other end's OPEN offers the ring lane on a link that may use it.
    pub(super) peer_offers_ring: bool,
    /// Whether the driver keeps a packet that the socket did not accept.
    pub(super) blocked: bool,
    /// All outputs except [`Output::Transmit`], which is built when it is polled.
    pub(super) events: VecDeque<Output>,
    /// The lane of its messages, with the state of that lane.
    pub(super) lane: Lane,
    pub(super) placed: Placed,
    pub(super) served: Served,
    /// The length of the longest message that the other end accepts, in bytes.
    pub(super) peer_max_len: u64,
    /// The publications that the other end's OPEN states.
    pub(super) peer_publications: Publications,
    pub(super) qos_timers: QosTimers,
}

/// The state of a link that is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Over {
    pub(super) end: End,
    /// The code of a CLOSE that `poll` has to return.
    pub(super) close: Option<Code>,
}

impl Link {
    /// Creates an end of a link. Its first output is the packet with OPEN. If this end offers the ring lane and
    /// receives messages, the packet with RING follows.
    ///
    /// A `depth` or `max_borrowed` out of range is clamped to the range. Links of services are
    /// reliable whatever `config` says.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let config = config.in_range();
        Self {
            config,
            state: Ok(Phase::Opening),
            open_sent: false,
            ring_due: config.ring && config.role.receives(),
            peer_offers_ring: false,
            blocked: false,
            events: VecDeque::new(),
            lane: Lane::new(&config),
            placed: Placed::default(),
            served: Served::default(),
            // Its OPEN has not come.
            peer_max_len: MESSAGE_MAX,
            peer_publications: Publications::UNKNOWN,
            qos_timers: QosTimers::default(),
        }
    }

    fn handle_live(&mut self, now: Instant, phase: Phase, input: Input<'_>) -> Result<(), Error> {
        match input {
            Input::Datagram(datagram) => {
                debug_assert_drained(&self.events);
                //= SM2-TRN-003
                if datagram.bytes.is_empty() {
                    self.finish(End::Eof);
                    return Ok(());
                }
                self.receive(now, phase, &datagram)
                    .map_err(|violation| self.violated(violation))?;
            }
            Input::Eof => self.finish(End::Eof),
            Input::Drop(fate) => self.drop_publication(fate)?,
            Input::Tick(newest) => self.qos_timers.tick(&self.config, now, newest),
            Input::Assert(time) => {
                self.qos_timers
                    .assert_liveliness(&self.config, phase, time)?;
            }
            Input::SegmentMissing => {
                self.on_segment_missing();
                if let Some(end) = self.end() {
                    return Err(Error::Ended(end));
                }
            }
            Input::Cancel { call } => self.cancel(call)?,
            Input::Attach(segment) => self.attach(&segment)?,
            Input::Retire { segment } => self.retire(segment)?,
            Input::Blocked => self.blocked = true,
            Input::Writable => self.blocked = false,
            Input::Close(code) => self.finish(End::Local(code)),
        }
        Ok(())
    }

    /// Drops the messages that wait at this end and are older than their lifespan. Each input does so.
    //= SM2-QOS-010
    fn expire_unsent(&mut self, now: Instant) {
        if self.config.lifespan != Period::NONE && self.state.is_ok() {
            let events = &mut self.events;
            self.lane.expire_unsent(now, |key| {
                let fate = Fate::Expired;
                events.push_back(Output::Settled { key, fate });
            });
        }
    }

    fn handle_ended(&mut self, over: Over, input: &Input<'_>) {
        match input {
            Input::SegmentMissing => self.on_segment_missing(),
            Input::Blocked => {
                self.state = Err(Over {
                    close: None,
                    ..over
                });
            }
            _ => {}
        }
    }

    /// Counts a publication that is not sent on this link.
    fn drop_publication(&mut self, fate: Fate) -> Result<(), Misuse> {
        let waits = self.config.reliable;
        if self.config.role != Role::Sender || (fate == Fate::NoRoom && !waits) {
            return Err(Misuse::WrongRole);
        }
        if !fate.is_unsent() {
            return Err(Misuse::WrongFate);
        }
        match &mut self.lane {
            Lane::Undecided => Err(Misuse::NotOpen),
            Lane::Socket(socket) => socket.outbound.drop_publication(fate),
            Lane::Ring(ring) => {
                let sender = ring.sender_mut().ok_or(Misuse::NotOpen)?;
                sender.drop_publication(fate);
                Ok(())
            }
        }
    }

    fn cancel(&mut self, call: u64) -> Result<(), Misuse> {
        if self.config.role != Role::Caller {
            return Err(Misuse::WrongRole);
        }
        self.placed.cancel(call, self.lane.last_id())
    }

    fn attach(&mut self, segment: &SegmentInfo) -> Result<(), Misuse> {
        if !self.config.role.sends() {
            return Err(Misuse::WrongRole);
        }
        match &mut self.lane {
            Lane::Undecided => Err(Misuse::NotOpen),
            // The socket lane attaches a segment when it sends the first message in that segment.
            Lane::Socket(_) => match Geometry::new(segment.stride, segment.slots) {
                Some(_) => Ok(()),
                None => Err(Misuse::BadSegment),
            },
            Lane::Ring(ring) => {
                let sender = ring.sender_mut().ok_or(Misuse::NotOpen)?;
                sender.segments.attach(segment)
            }
        }
    }

    fn retire(&mut self, segment: u32) -> Result<(), Misuse> {
        if !self.config.role.sends() {
            return Err(Misuse::WrongRole);
        }
        match &mut self.lane {
            Lane::Undecided => Ok(()),
            Lane::Socket(socket) => socket.outbound.retire(segment),
            Lane::Ring(ring) => {
                (ring.sender_mut()).map_or(Ok(()), |it| it.segments.retire(segment))
            }
        }
    }

    /// Ends the link by a violation. No other function does so.
    //= SM2-OPN-008
    pub(super) fn violated(&mut self, violation: Violation) -> Error {
        let end = End::Violation(violation);
        self.finish(end);
        Error::Ended(end)
    }

    /// Ends the link. No other function does so.
    //= SM2-OPN-007, SM2-OPN-008, SM2-OPN-009, SM2-SRV-004
    pub(super) fn finish(&mut self, end: End) {
        let code = match end {
            End::Local(code) => Some(code),
            End::Violation(violation) => Some(violation.code()),
            End::Peer(_) | End::Eof => None,
        };
        let close = code.filter(|_| !self.blocked);
        self.state = Err(Over { end, close });
        let Self { lane, events, .. } = self;
        lane.end(matches!(end, End::Violation(_)), |key| {
            events.push_back(Output::Settled {
                key,
                fate: Fate::Closed,
            });
        });
        self.fail_calls();
        self.served.end();
        self.events.push_back(Output::Ended(end));
    }

    fn next_output(&mut self) -> Option<Output> {
        if let Err(over) = &mut self.state
            && let Some(code) = over.close.take()
        {
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

    /// Builds the next frame from the current state: OPEN first, then RING, and frames that give back before
    /// frames that ask for something.
    //= SM2-OPN-001, SM2-RNG-002
    fn transmit(&mut self) -> Option<Packet> {
        if !self.open_sent {
            self.open_sent = true;
            return Some(Packet::bare(self.open().head()));
        }
        if self.ring_due {
            self.ring_due = false;
            return self.ring();
        }
        let packet = match &mut self.lane {
            Lane::Undecided => return None,
            Lane::Socket(socket) => socket.inbound.poll(),
            Lane::Ring(ring) => ring.poll(),
        };
        if packet.is_some() {
            return packet;
        }
        if let Some(time) = self.qos_timers.take_alive() {
            return Some(Packet::bare(Frame::Alive { time }.head()));
        }
        if let Some(call) = self.placed.poll() {
            return Some(Packet::bare(Frame::Cancel { call }.head()));
        }
        let Lane::Socket(socket) = &mut self.lane else {
            return None;
        };
        let OutboundFrame { packet, id } = socket.outbound.poll()?;
        match (self.config.role, id) {
            (Role::Caller, Some(call)) => self.placed.sent(call),
            (Role::Server, Some(call)) => self.served.sent(call),
            _ => {}
        }
        Some(packet)
    }

    /// Our RING.
    fn ring(&self) -> Option<Packet> {
        let layout = self.config.ring_layout()?;
        let (depth, window) = (layout.depth(), layout.window());
        Some(Packet {
            attachment: Some(Attachment::Ring),
            ..Packet::bare(Frame::Ring { depth, window }.head())
        })
    }

    /// Our OPEN.
    //= SM2-OPN-002, SM2-OPN-003, SM2-OPN-004, SM2-OPN-005, SM2-OPN-006, SM2-RNG-001
    fn open(&self) -> Frame<'static> {
        Frame::Open(Open {
            role: self.config.role as u8,
            version: self.config.version,
            window: self.config.window(),
            link: self.config.id,
            lanes: LANE_SOCKET | if self.config.ring { LANE_RING } else { 0 },
            max_len: self.config.max_len_units(),
            publications: self.config.publications,
        })
    }

    /// Checks the invariants, which hold after each call. Free in release builds.
    #[inline]
    pub(super) fn invariants(&self) {
        if cfg!(debug_assertions) {
            self.lane.invariants();
            self.placed.invariants();
            self.served.invariants();
            let is_over = self.state.is_err();
            debug_assert!(!is_over || self.in_flight() == 0);
            debug_assert!(!is_over || self.calls() == 0 || self.may_bring_replies());
            let is_undecided = matches!(self.lane, Lane::Undecided);
            debug_assert!(is_over || !is_undecided || self.state == Ok(Phase::Opening));
        }
    }
}

/// All outputs must be drained before [`Input::Datagram`] is fed, because [`Output::Attach`],
/// [`Output::Ring`] and [`Output::Keep`] refer to the descriptor of the datagram just handled. A
/// debug assertion checks this for all outputs but [`Output::Transmit`], which is built when it is
/// polled. All other inputs may be fed while outputs are pending.
impl Machine for Link {
    type Input<'a> = Input<'a>;
    type Output = Output;
    type End = End;
    type Misuse = Misuse;

    /// [`Error::Ended`]: the link was over before, or a violation in
    /// this very input has ended it; the outputs carry the consequences. All other ends are not errors
    /// of the input that brings them: only [`Output::Ended`] reports them.
    fn handle(&mut self, now: Instant, input: Input<'_>) -> Result<(), Error> {
        let result = match self.state {
            Ok(phase) => {
                let shows_life = matches!(input, Input::Drop(_));
                let result = self.handle_live(now, phase, input);
                if shows_life && result.is_ok() {
                    self.qos_timers.show_life(&self.config, now);
                }
                if self.state == Ok(Phase::Open) {
                    self.qos_timers.start_watch(&self.config, now);
                }
                self.expire_unsent(now);
                result
            }
            Err(over) => {
                self.handle_ended(over, &input);
                Err(Error::Ended(over.end))
            }
        };
        self.invariants();
        result
    }

    fn poll(&mut self) -> Option<Output> {
        let output = self.next_output();
        self.invariants();
        output
    }

    /// The time of the next [tick](super::Input::Tick); `None` unless a receiver demands a deadline or a lease, or
    /// ALIVE is held back.
    fn deadline(&self) -> Option<Instant> {
        let next_tick = self.qos_timers.next_tick();
        next_tick.filter(|_| self.state.is_ok())
    }
}
