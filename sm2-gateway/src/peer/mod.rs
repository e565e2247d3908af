//! One connection with one peer: QUIC, and above it the session and the scheduler.
//!
//! [`Peer`] is a [`Machine`] with one more step: after the outputs of an input are drained, its driver
//! calls [`poll_transmit`](Peer::poll_transmit) until there is no datagram to send. The machines of
//! `sm2_proto::gateway` decide what is legal; this module maps them to QUIC streams.

mod ahead;
mod budget;
mod calls;
mod command;
mod commands;
mod event;
mod gate;
mod id;
mod incoming;
mod limits;
mod machine;
mod offers;
mod open_calls;
mod outgoing;
mod outlet;
mod phase;
mod reading;
mod stream;
mod topics;
mod unacked;
mod waiting_offers;
mod writing;

use std::{
    collections::{BTreeMap, VecDeque},
    convert::Infallible,
    time::Duration,
};

use bytes::Bytes;
use quinn_proto::{Connection, ConnectionError, Dir, Side, StreamEvent, Transmit};
use sm2_io::quic::peer_of;
use sm2_proto::{
    Code, Instant, Machine, MisuseError, Name,
    gateway::{
        GatewayId, Header, Outcome, PeerFarewell, PeerViolation, StreamEnd, SubjectKind,
        session::{self, End, Initiator, PeerEvent, PeerSession, Transport},
    },
};

use self::{
    ahead::Ahead,
    gate::Gate,
    incoming::Incoming,
    open_calls::OpenCalls,
    outlet::Outlet,
    phase::{Open, Phase},
    stream::{quic_code, stream_id},
    topics::Topics,
    unacked::Unacked,
    waiting_offers::WaitingOffers,
};
pub use self::{
    budget::{Budget, Member},
    command::Command,
    event::{Event, HandshakeError, Reason},
    id::{CallId, ConnectionId, Me, PeerCall},
    limits::{Limit, Limits, Usage},
    machine::{Input, Output},
};
pub use crate::message::Message;
use crate::{
    clock::{Clock, Now},
    tally::{Counts, Tally, Whose},
};

/// A stream that brings nothing for this long is refused.
//= SM2-GWM-010
const STUCK_TIMEOUT: Duration = Duration::from_secs(30);
/// No message starts while those that were started and are not acknowledged take this part of the memory: so there is
/// always memory for what arrives, whatever the peer does not acknowledge.
const SENDING_DIVISOR: u64 = 2;
/// The most bytes that one system call can send over UDP, in any number of datagrams: an IPv4 packet less the headers
/// of IP and UDP. Linux refuses more (EMSGSIZE), and then all of these datagrams are lost.
const TRANSMIT_MAX_BYTES: usize = 65_535 - 20 - 8;

/// A connection with a peer.
#[derive(Debug)]
pub struct Peer {
    connection: Connection,
    clock: Clock,
    limits: Limits,
    budget: Budget,
    me: Me,
    /// The least epoch that the HELLO of each peer may have: that of its open connection.
    least_epochs: BTreeMap<GatewayId, u64>,
    phase: Phase,
    incoming: Incoming,
    waiting_offers: WaitingOffers,
    topics: Topics,
    calls: OpenCalls,
    unacked: Unacked,
    ahead: Ahead,
    gate: Option<Gate>,
    tally: Tally,
    /// The time of QUIC's next timer.
    quic_deadline: Option<Instant>,
    events: VecDeque<Event>,
}

impl Machine for Peer {
    type Input<'a> = Input;
    type Output = Output;
    /// A connection that has ended still takes inputs: it answers datagrams until
    /// [`is_drained`](Self::is_drained).
    type End = Infallible;
    /// Every input is legal once the outputs of the input before are drained.
    type Misuse = Infallible;

    fn handle(&mut self, now: Instant, input: Input) -> Result<(), MisuseError<Infallible>> {
        debug_assert!(
            self.events.is_empty(),
            "the outputs of the input before have to be polled first"
        );
        let now = self.clock.at(now);
        match input {
            Input::Quic(event) => self.connection.handle_event(event),
            Input::Command(command) => self.command(now, command),
            Input::Tick => self.tick(now),
        }
        self.advance(now);
        self.refresh_deadline();
        Ok(())
    }

    fn poll(&mut self) -> Option<Output> {
        if let Some(event) = self.events.pop_front() {
            return Some(Output::Event(event));
        }
        self.connection.poll_endpoint_events().map(Output::Endpoint)
    }

    fn deadline(&self) -> Option<Instant> {
        let session = self.phase.open().and_then(|it| it.session.deadline());
        let stuck = self.incoming.longest_silent();
        let stuck = stuck.map(|(_, since)| since.after(STUCK_TIMEOUT));
        let deadlines = [self.quic_deadline, session, stuck, self.topics.deadline()];
        deadlines.into_iter().flatten().min()
    }
}

impl Peer {
    /// A connection that was just dialled, or whose first datagram has arrived.
    #[must_use]
    pub fn new(
        connection: Connection,
        clock: Clock,
        me: Me,
        least_epochs: BTreeMap<GatewayId, u64>,
        limits: Limits,
    ) -> Self {
        let mut peer = Self {
            connection,
            clock,
            limits,
            budget: Budget::new(limits.gateway_bytes),
            me,
            least_epochs,
            phase: Phase::Handshake,
            incoming: Incoming::default(),
            waiting_offers: WaitingOffers::default(),
            topics: Topics::new(limits.memory_bytes),
            calls: OpenCalls::default(),
            unacked: Unacked::default(),
            ahead: Ahead::default(),
            gate: None,
            tally: Tally::default(),
            quic_deadline: None,
            events: VecDeque::new(),
        };
        peer.refresh_deadline();
        peer
    }

    /// Shares the memory of the gateway with the other connections of `budget`.
    #[must_use]
    pub fn with_budget(mut self, budget: Budget) -> Self {
        self.budget = budget;
        self
    }

    /// The memory that this peer may use now: for payloads that arrive, that wait, that are being written, and that
    /// QUIC holds.
    fn memory_bytes(&self) -> u64 {
        let part = self.phase.open().map(|it| it.member.part_bytes());
        self.limits.memory_bytes.min(part.unwrap_or(u64::MAX))
    }

    /// The memory of what is for the peer and cannot be dropped: all but the messages that wait.
    fn sending_bytes(&self) -> u64 {
        let writing_bytes = self.calls.writing_bytes() + self.topics.in_flight_bytes();
        writing_bytes + self.unacked.bytes()
    }

    /// The side that opened the connection.
    #[must_use]
    pub fn initiator(&self) -> Initiator {
        match self.connection.side() {
            Side::Client => Initiator::ThisGateway,
            Side::Server => Initiator::Peer,
        }
    }

    /// The counts of all messages and calls.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        self.tally.total()
    }

    /// The counts of each topic and service.
    pub fn counts_by_name(&self) -> impl Iterator<Item = (&(SubjectKind, Name), Counts)> {
        self.tally.names()
    }

    /// The streams, payloads and calls that are not complete.
    #[must_use]
    pub fn usage(&mut self) -> Usage {
        let streams = self.connection.streams();
        Usage {
            bidirectional_streams: streams.remote_open_streams(Dir::Bi),
            unidirectional_streams: streams.remote_open_streams(Dir::Uni),
            payloads: self.incoming.len(),
            calls: self.calls.len(),
        }
    }

    /// The current estimate of the round-trip time.
    #[must_use]
    pub fn rtt(&self) -> Duration {
        self.connection.rtt()
    }

    /// The time since which the connection is established; `None` before and after.
    pub(crate) fn established_at(&self) -> Option<Instant> {
        self.phase.open().map(|it| it.since)
    }

    /// The current address of the peer.
    #[must_use]
    pub fn address(&self) -> std::net::SocketAddr {
        self.connection.remote_address()
    }

    /// True if the connection is drained: it is closed, and need not answer datagrams any more.
    #[must_use]
    pub fn is_drained(&self) -> bool {
        self.connection.is_drained()
    }

    /// Writes the next datagrams to `buffer`, at most `max_datagrams` and no more bytes than one system call can send;
    /// `None` if there are none to send now.
    pub fn poll_transmit(
        &mut self,
        now: Instant,
        max_datagrams: usize,
        buffer: &mut Vec<u8>,
    ) -> Option<Transmit> {
        let now = self.clock.at(now);
        let mtu = usize::from(self.connection.current_mtu());
        let max_datagrams = max_datagrams.min(TRANSMIT_MAX_BYTES / mtu).max(1);
        let transmit = loop {
            let next = (self.connection).poll_transmit(now.quic, max_datagrams, buffer);
            if let Some(transmit) = &next {
                self.ahead.sent(transmit);
                break next;
            }
            if !self.write(now) {
                break None;
            }
        };
        self.refresh_deadline();
        transmit
    }

    fn refresh_deadline(&mut self) {
        let deadline = self.connection.poll_timeout();
        self.quic_deadline = deadline.map(|it| self.clock.of(it));
    }

    fn tick(&mut self, now: Now) {
        if self.quic_deadline.is_some_and(|it| it <= now.at) {
            self.connection.handle_timeout(now.quic);
        }
        // A session that has ended, or does not exist yet, has no timers.
        self.session_takes(now, session::Input::Tick);
        while let Some((id, since)) = self.incoming.longest_silent()
            && now.at.since(since) >= STUCK_TIMEOUT
        {
            self.refuse(now, id, StreamEnd::Expired.code());
        }
        let (topics, mut outlet) = self.topics(now);
        topics.tick(&mut outlet);
    }

    /// The topics, and what their messages are written to and counted in.
    fn topics(&mut self, now: Now) -> (&mut Topics, Outlet<'_>) {
        let outlet = Outlet {
            now: now.at,
            connection: &mut self.connection,
            tally: &mut self.tally,
            unacked: &mut self.unacked,
            gate: self.gate.as_ref(),
        };
        (&mut self.topics, outlet)
    }

    /// Feeds the session and carries out its outputs. False if the session did not take the input.
    fn session_takes(&mut self, now: Now, input: session::Input<'_>) -> bool {
        matches!(self.feed_session(now, input, None), Some(Ok(())))
    }

    /// Feeds the session and carries out its outputs. `datagram` is the message of the datagram that
    /// the input reports. None if there is no session, or none any more.
    fn feed_session(
        &mut self,
        now: Now,
        input: session::Input<'_>,
        datagram: Option<(Header, Bytes)>,
    ) -> Option<Result<(), session::Error>> {
        let taken = self.phase.open_mut()?.session.handle(now.at, input);
        self.drain_session(now, datagram);
        Some(taken)
    }

    fn session_event(&mut self, now: Now, event: PeerEvent<'_>) -> bool {
        self.session_takes(now, session::Input::Event(event))
    }

    fn session_command(&mut self, now: Now, command: session::Command) -> bool {
        self.session_takes(now, session::Input::Command(command))
    }

    /// Handles the events of QUIC and the outputs of the session.
    fn advance(&mut self, now: Now) {
        while let Some(event) = self.connection.poll() {
            self.on_quic(now, event);
        }
        self.make_offers(now);
        self.write_control(now);
        let memory_bytes = self.memory_bytes();
        let used_bytes = self.incoming.held_bytes() + self.calls.writing_bytes();
        let max_bytes = memory_bytes.saturating_sub(used_bytes + self.unacked.bytes());
        let (topics, mut outlet) = self.topics(now);
        topics.limit(&mut outlet, max_bytes, memory_bytes / SENDING_DIVISOR);
    }

    fn on_quic(&mut self, now: Now, event: quinn_proto::Event) {
        use quinn_proto::Event as Quic;
        match event {
            Quic::HandshakeDataReady | Quic::DatagramsUnblocked => {}
            Quic::Connected => self.greet(now),
            Quic::ConnectionLost { reason } => self.lost(now, &reason),
            Quic::Stream(StreamEvent::Opened { dir }) => self.accept(now, dir),
            Quic::Stream(StreamEvent::Readable { id }) => self.read(now, id),
            Quic::Stream(StreamEvent::Stopped { id, error_code }) => {
                self.stopped(now, id, error_code);
            }
            Quic::Stream(StreamEvent::Finished { id }) => self.unacked.remove(id),
            Quic::Stream(StreamEvent::Writable { .. } | StreamEvent::Available { .. }) => {}
            Quic::DatagramReceived => self.datagrams(now),
        }
    }

    /// The handshake is complete.
    fn greet(&mut self, now: Now) {
        let Some(peer) = peer_of(&self.connection) else {
            // A handshake without a key fails, so this is not reached.
            return self.over(now, Reason::Handshake(HandshakeError::NoKey));
        };
        let least = self.least_epochs.get(&peer).copied().unwrap_or(0);
        let Me { hop, name } = self.me.clone();
        let control = match self.initiator() {
            Initiator::ThisGateway => self.connection.streams().open(Dir::Bi),
            Initiator::Peer => None,
        };
        self.phase = Phase::Session(Box::new(Open {
            since: now.at,
            session: PeerSession::new(now.at, hop, name, peer, least),
            control,
            control_out: VecDeque::new(),
            member: self.budget.join(),
        }));
        // The HELLO of this side.
        self.drain_session(now, None);
    }

    fn lost(&mut self, now: Now, reason: &ConnectionError) {
        let code = match reason {
            ConnectionError::ApplicationClosed(close) => {
                u16::try_from(close.error_code.into_inner()).ok().map(Code)
            }
            _ => None,
        };
        match self.phase {
            Phase::Handshake => self.over(now, Reason::Handshake(reason.clone().into())),
            Phase::Session(_) => {
                self.session_event(now, PeerEvent::Closed(code));
            }
            Phase::Over => {}
        }
    }

    fn violated(&mut self, now: Now, violation: PeerViolation) {
        self.session_event(now, PeerEvent::Violation(violation));
    }

    /// Carries out the outputs of the session. `datagram` is the message that the session was asked
    /// about.
    fn drain_session(&mut self, now: Now, mut datagram: Option<(Header, Bytes)>) {
        while let Some(open) = self.phase.open_mut()
            && let Some(output) = open.session.poll()
        {
            match output {
                session::Output::Transmit(bytes) => open.control_out.push_back(bytes.into()),
                session::Output::Event(event) => self.session_said(now, event),
                session::Output::Take {
                    transport: Transport::Datagram,
                } => {
                    if let Some((header, payload)) = datagram.take() {
                        self.datagram(now, &header, payload);
                    }
                }
                // The bytes of a stream are collected until the stream is stopped.
                session::Output::Take {
                    transport: Transport::Stream(_),
                } => {}
                session::Output::Discard {
                    transport: Transport::Datagram,
                } => datagram = None,
                session::Output::Discard {
                    transport: Transport::Stream(stream),
                } => self.stop(stream_id(stream), StreamEnd::Withdrawn.code()),
                session::Output::Unreachable { stream } => {
                    let id = stream_id(stream);
                    self.stop(id, StreamEnd::Withdrawn.code());
                    self.reply(PeerCall(stream), Outcome::Unreachable, Bytes::new());
                }
                session::Output::CallFailed { stream } => {
                    if let Some(call) = self.abandon(stream_id(stream)) {
                        self.events.push_back(Event::unreachable(call));
                    }
                }
                session::Output::Ended(end) => self.over(now, Reason::Session(end)),
            }
        }
    }

    /// Updates the topics and the counts, and passes the event up.
    fn session_said(&mut self, now: Now, event: session::Event) {
        match &event {
            session::Event::Offered { offer, subject, .. } => {
                self.tally.open(Whose::Theirs(*offer), subject);
            }
            session::Event::Gone { offer } => self.tally.close(Whose::Theirs(*offer)),
            session::Event::Wanted { offer, depth } => {
                let (topics, mut outlet) = self.topics(now);
                topics.wanted(&mut outlet, *offer, *depth);
            }
            session::Event::Unwanted { offer } => {
                let (topics, mut outlet) = self.topics(now);
                topics.unwanted(&mut outlet, *offer);
            }
            session::Event::Greeted { .. }
            | session::Event::Asked { .. }
            | session::Event::Answered { .. } => {}
        }
        self.events.push_back(Event::Session(event));
    }

    /// Ends the connection and tells the peer.
    //= SM2-GWE-001
    fn over(&mut self, now: Now, reason: Reason) {
        if self.phase.is_over() {
            return;
        }
        self.phase = Phase::Over;
        let code = match &reason {
            Reason::Session(End::Violation(violation)) => Some(violation.code()),
            Reason::Session(End::Local(code)) => Some(*code),
            Reason::Session(End::Closed(_)) => None,
            Reason::Handshake(_) => Some(PeerFarewell::Done.code()),
        };
        if !self.connection.is_closed() {
            let code = code.unwrap_or_else(|| PeerFarewell::Done.code());
            let text = Bytes::from(reason.to_string());
            self.connection.close(now.quic, quic_code(code), text);
        }
        let failed = self.calls.end(&mut self.tally);
        self.events.extend(failed.map(Event::unreachable));
        let (topics, mut outlet) = self.topics(now);
        topics.end(&mut outlet);
        self.events.push_back(Event::Ended(reason));
    }
}
