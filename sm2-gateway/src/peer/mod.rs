//! One connection with one peer: QUIC below, the session and the schedule above.
//!
//! It does no I/O and reads no clock. Feed it datagrams and time, tell it what to do with
//! [`command`](Peer::command), send what [`poll_transmit`](Peer::poll_transmit) gives, and take what
//! happened from [`poll`](Peer::poll). What it does with a peer that breaks the rules is in
//! `sm2_proto::gateway`; here is only how streams carry it.

mod ahead;
mod calls;
mod id;
mod incoming;
mod offers;
mod outgoing;
mod reading;
mod topics;
mod words;
mod writing;

use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use bytes::Bytes;
use quinn_proto::{
    Connection, ConnectionError, ConnectionEvent, Dir, EndpointEvent, Side, StreamEvent, StreamId,
    Transmit, VarInt,
};
use sm2_io::quic::peer_of;
use sm2_proto::{
    Code, Instant, Machine, Name,
    gateway::{
        GatewayId, Header, Outcome, PeerFarewell, PeerViolation, StreamEnd, StreamToken,
        SubjectKind,
        session::{self, Carrier, End, Input, Output, PeerEvent, Session},
    },
};

pub use self::id::{CallId, ConnectionId, PeerCall};
pub use self::words::{Command, Event, Held, Limits, Me, Reason};
use self::{
    ahead::Ahead,
    calls::Calls,
    incoming::Incoming,
    offers::{Offer, Waiting},
    topics::{Outlet, Topics},
};
pub use crate::message::Message;
use crate::{
    clock::{Clock, Now},
    tally::{Counts, Tally, Whose},
};

/// A stream that carries nothing for so long is not read any more.
const STUCK: Duration = Duration::from_secs(30);

/// A connection.
#[derive(Debug)]
pub struct Peer {
    connection: Connection,
    clock: Clock,
    limits: Limits,
    me: Me,
    /// Of the peer's epochs that are known, by peer: the greatest.
    least_epochs: BTreeMap<GatewayId, u64>,
    peer: Option<GatewayId>,
    /// From the end of the handshake on.
    session: Option<Session>,
    control: Option<StreamId>,
    control_out: VecDeque<Bytes>,
    incoming: Incoming,
    waiting: Waiting,
    topics: Topics,
    calls: Calls,
    ahead: Ahead,
    tally: Tally,
    events: VecDeque<Event>,
    is_over: bool,
}

impl Peer {
    /// A connection that was just dialled, or whose first datagram has come.
    #[must_use]
    pub fn new(
        connection: Connection,
        clock: Clock,
        me: Me,
        least_epochs: BTreeMap<GatewayId, u64>,
        limits: Limits,
    ) -> Self {
        Self {
            connection,
            clock,
            limits,
            me,
            least_epochs,
            peer: None,
            session: None,
            control: None,
            control_out: VecDeque::new(),
            incoming: Incoming::default(),
            waiting: Waiting::default(),
            topics: Topics::default(),
            calls: Calls::default(),
            ahead: Ahead::default(),
            tally: Tally::default(),
            events: VecDeque::new(),
            is_over: false,
        }
    }

    /// Whether this side opened it.
    #[must_use]
    pub fn is_dialled(&self) -> bool {
        self.connection.side() == Side::Client
    }

    /// What was sent, and what was not.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        self.tally.total()
    }

    /// Of that, what is known to be of a topic or a service.
    pub fn counts_by_name(&self) -> impl Iterator<Item = (&(SubjectKind, Name), Counts)> {
        self.tally.names()
    }

    /// What is not over on it.
    #[must_use]
    pub fn held(&mut self) -> Held {
        let streams = self.connection.streams();
        Held {
            bidirectional: streams.remote_open_streams(Dir::Bi),
            unidirectional: streams.remote_open_streams(Dir::Uni),
            payloads: self.incoming.len(),
            calls: self.calls.len(),
        }
    }

    /// The time that it takes there and back.
    #[must_use]
    pub fn rtt(&self) -> Duration {
        self.connection.rtt()
    }

    /// Where the other side is.
    #[must_use]
    pub fn address(&self) -> std::net::SocketAddr {
        self.connection.remote_address()
    }

    /// Whether nothing is left to be done: the endpoint has forgotten it.
    #[must_use]
    pub fn is_drained(&self) -> bool {
        self.connection.is_drained()
    }

    /// Takes what the endpoint has for it.
    pub fn handle_event(&mut self, now: Now, event: ConnectionEvent) {
        self.connection.handle_event(event);
        self.turn(now);
    }

    /// To be called at the [`deadline`](Self::deadline).
    pub fn handle_timeout(&mut self, now: Now) {
        if self
            .connection
            .poll_timeout()
            .is_some_and(|it| it <= now.quic)
        {
            self.connection.handle_timeout(now.quic);
        }
        self.session_takes(now, Input::Tick);
        while let Some((id, since)) = self.incoming.slowest()
            && now.at.since(since) >= STUCK
        {
            self.refuse(now, id, StreamEnd::Expired.code());
        }
        let (topics, mut outlet) = self.topics(now);
        topics.tick(&mut outlet);
        self.turn(now);
    }

    /// When there is something to do if nothing happens until then.
    #[must_use]
    pub fn deadline(&mut self) -> Option<Instant> {
        let clock = self.clock;
        let quic = self.connection.poll_timeout().map(|it| clock.of(it));
        let session = self.session.as_ref().and_then(Session::deadline);
        let stuck = self.incoming.slowest().map(|(_, since)| since.after(STUCK));
        let topics = self.topics.deadline();
        [quic, session, stuck, topics].into_iter().flatten().min()
    }

    /// What is to be sent next, in `buffer`.
    pub fn poll_transmit(
        &mut self,
        now: Now,
        max_datagrams: usize,
        buffer: &mut Vec<u8>,
    ) -> Option<Transmit> {
        loop {
            let next = (self.connection).poll_transmit(now.quic, max_datagrams, buffer);
            if let Some(transmit) = &next {
                self.ahead.sent(transmit);
                return next;
            }
            if !self.write(now) {
                return None;
            }
        }
    }

    /// What the endpoint is to be told.
    pub fn poll_endpoint(&mut self) -> Option<EndpointEvent> {
        self.connection.poll_endpoint_events()
    }

    /// What happened.
    pub fn poll(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Does what the gateway wants. What can no longer be done, since the peer has changed its mind
    /// meanwhile, is left undone; a call that cannot be made is unreachable.
    pub fn command(&mut self, now: Now, command: Command) {
        match command {
            Command::Offer {
                offer,
                subject,
                path,
                qos,
            } => {
                let it = Offer { subject, path, qos };
                self.offer(now, offer, it);
            }
            Command::Unoffer { offer } => self.withdraw(now, offer),
            Command::Change { offer, qos } => self.change(now, offer, qos),
            Command::Want { offer, depth } => {
                self.session_command(now, session::Command::Want { offer, depth });
            }
            Command::Unwant { offer } => {
                self.session_command(now, session::Command::Unwant { offer });
            }
            Command::Ask { ask, kind, name } => {
                if !self.session_command(now, session::Command::Ask { ask, kind, name }) {
                    self.events.push_back(Event::NotAsked { ask });
                }
            }
            Command::Answer { ask, verdict } => {
                self.session_command(now, session::Command::Answer { ask, verdict });
            }
            Command::Message { offer, message } => {
                let (topics, mut outlet) = self.topics(now);
                topics.publish(&mut outlet, offer, message);
            }
            Command::Call {
                call,
                offer,
                deadline,
                payload,
            } => self.call(now, call, offer, deadline, payload),
            Command::Forget { call } => self.forget(now, call),
            Command::Reply {
                call,
                outcome,
                payload,
            } => self.reply(call, outcome, payload),
            Command::Close(code) => {
                self.session_takes(now, Input::Close(code));
            }
        }
        self.turn(now);
    }

    /// The topics, and what their messages are written to and counted in.
    fn topics(&mut self, now: Now) -> (&mut Topics, Outlet<'_>) {
        let outlet = Outlet {
            now: now.at,
            connection: &mut self.connection,
            tally: &mut self.tally,
        };
        (&mut self.topics, outlet)
    }

    /// Feeds the session and executes its outputs. False if the session did not take the input.
    fn session_takes(&mut self, now: Now, input: Input<'_>) -> bool {
        matches!(self.feed_session(now, input, None), Some(Ok(())))
    }

    /// Feeds the session and executes its outputs. `datagram` is the message of the datagram that
    /// the input reports. None if there is no session yet.
    fn feed_session(
        &mut self,
        now: Now,
        input: Input<'_>,
        datagram: Option<(Header, Bytes)>,
    ) -> Option<Result<(), session::Error>> {
        let taken = self.session.as_mut()?.handle(now.at, input);
        self.drain_session(now, datagram);
        Some(taken)
    }

    fn session_event(&mut self, now: Now, event: PeerEvent<'_>) -> bool {
        self.session_takes(now, Input::Event(event))
    }

    fn session_command(&mut self, now: Now, command: session::Command) -> bool {
        self.session_takes(now, Input::Command(command))
    }

    /// Does all that can be done now.
    fn turn(&mut self, now: Now) {
        while let Some(event) = self.connection.poll() {
            self.on_quic(now, event);
        }
        self.make_offers(now);
        if !self.is_over {
            self.write_control(now);
        }
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
            Quic::Stream(
                StreamEvent::Writable { .. }
                | StreamEvent::Finished { .. }
                | StreamEvent::Available { .. },
            ) => {}
            Quic::DatagramReceived => self.datagrams(now),
        }
    }

    /// The handshake is done.
    fn greet(&mut self, now: Now) {
        let Some(peer) = peer_of(&self.connection) else {
            // No handshake ends without a key.
            return self.over(now, Reason::Handshake("the peer showed no key".to_owned()));
        };
        self.peer = Some(peer);
        let least = self.least_epochs.get(&peer).copied().unwrap_or(0);
        let Me { hop, name } = self.me.clone();
        self.session = Some(Session::new(now.at, hop, name, peer, least));
        if self.is_dialled() {
            self.control = self.connection.streams().open(Dir::Bi);
        }
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
        if self.session.is_some() {
            self.session_event(now, PeerEvent::Closed(code));
        } else {
            self.over(now, Reason::Handshake(reason.to_string()));
        }
    }

    fn violated(&mut self, now: Now, violation: PeerViolation) {
        self.session_event(now, PeerEvent::Violation(violation));
    }

    fn drain_session(&mut self, now: Now, mut datagram: Option<(Header, Bytes)>) {
        while let Some(output) = self.session.as_mut().and_then(Session::poll) {
            match output {
                Output::Transmit(bytes) => self.control_out.push_back(bytes.into()),
                Output::Event(event) => self.session_said(now, event),
                Output::Take {
                    carrier: Carrier::Datagram,
                } => {
                    if let Some((header, payload)) = datagram.take() {
                        self.datagram(now, &header, payload);
                    }
                }
                // The bytes of a stream are kept unless the stream was stopped.
                Output::Take {
                    carrier: Carrier::Stream(_),
                } => {}
                Output::Discard {
                    carrier: Carrier::Datagram,
                } => datagram = None,
                Output::Discard {
                    carrier: Carrier::Stream(stream),
                } => self.stop(stream_id(stream), StreamEnd::Withdrawn.code()),
                Output::Unreachable { stream } => {
                    let id = stream_id(stream);
                    self.stop(id, StreamEnd::Withdrawn.code());
                    self.reply(PeerCall(stream), Outcome::Unreachable, Bytes::new());
                }
                Output::CallFailed { stream } => {
                    if let Some(call) = self.abandon(stream_id(stream)) {
                        self.events.push_back(unreachable_call(call));
                    }
                }
                Output::Ended(end) => self.over(now, Reason::Said(end)),
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

    /// The connection is over: the other side is told, and nothing is left but to do so.
    //= SM2-GWE-001
    fn over(&mut self, now: Now, reason: Reason) {
        if self.is_over {
            return;
        }
        self.is_over = true;
        let code = match &reason {
            Reason::Said(End::Violation(violation)) => Some(violation.code()),
            Reason::Said(End::Local(code)) => Some(*code),
            Reason::Said(End::Closed(_)) => None,
            Reason::Handshake(_) => Some(PeerFarewell::Done.code()),
        };
        if !self.connection.is_closed() {
            let code = code.unwrap_or_else(|| PeerFarewell::Done.code());
            let text = Bytes::from(reason.to_string());
            self.connection.close(now.quic, code_of(code), text);
        }
        let failed = self.calls.end(&mut self.tally);
        self.events.extend(failed.map(unreachable_call));
        let (topics, mut outlet) = self.topics(now);
        topics.end(&mut outlet);
        self.events.push_back(Event::Ended(reason));
    }
}

fn unreachable_call(call: CallId) -> Event {
    Event::Reply {
        call,
        outcome: Outcome::Unreachable,
        payload: Bytes::new(),
    }
}

fn code_of(code: Code) -> VarInt {
    VarInt::from_u32(code.0.into())
}

fn token(id: StreamId) -> StreamToken {
    StreamToken(id.into())
}

fn stream_id(stream: StreamToken) -> StreamId {
    StreamId::from(VarInt::from_u64(stream.0).unwrap_or(VarInt::MAX))
}
