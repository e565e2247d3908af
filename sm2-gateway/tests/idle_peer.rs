//! A peer that sends or reads nothing where it should, in virtual time.

// Shows GW-LIMIT (test), bound: a raw QUIC peer, in virtual time.

use std::{collections::BTreeMap, net::SocketAddr, sync::Arc, time::Duration};

use bytes::{Bytes, BytesMut};
use quinn_proto::{
    Connection, ConnectionError, ConnectionHandle, DatagramEvent, Dir, EndpointConfig, StreamEvent,
    StreamId, TransportConfig, VarInt, crypto::rustls::QuicClientConfig,
};
use sm2_gateway::{
    clock::Clock,
    hub::DEFAULT_SEND_QOS,
    peer::{Command, Input, Limits, Me, Message, Output, Peer},
};
use sm2_io::quic::{Arrival, Congestion, Endpoint, SecretKey, Trusted};
use sm2_proto::{
    Instant, Machine, Name, TypeId,
    gateway::{
        Frame, GatewayId, Header, HeaderKind, Hop, OfferId, PeerFarewell, StreamEnd, Subject,
        session::ControlCommand,
    },
};

use crate::hostile_peers::identity::honest_tls;

/// A stream that brings nothing for this time is stopped.
const SILENCE: Duration = Duration::from_secs(30);
/// A connection without a HELLO for this time is closed.
const GREETING: Duration = Duration::from_secs(2);
const MOMENT: Duration = Duration::from_millis(100);
const OFFER: OfferId = OfferId(1);

/// A gateway, and a peer that the test drives by hand. Datagrams need no time.
struct World {
    now: Instant,
    clock: Clock,
    me: Me,
    /// The id of the hand.
    id: GatewayId,
    addresses: [SocketAddr; 2],
    hand_endpoint: quinn_proto::Endpoint,
    hand: (ConnectionHandle, Connection),
    gateway_endpoint: Endpoint,
    gateway: Option<(ConnectionHandle, Peer)>,
    limits: Limits,
    /// The streams that the gateway has stopped, with its codes.
    stopped: Vec<(StreamId, u64)>,
    /// The code that the gateway has closed the connection with.
    closed: Option<u64>,
}

impl World {
    /// A world where the hand has sent nothing since the handshake.
    fn silent(transport: TransportConfig) -> Self {
        Self::limited(transport, Limits::default())
    }

    /// The same, for a gateway with these limits.
    fn limited(transport: TransportConfig, limits: Limits) -> Self {
        let clock = Clock::of_the_machine();
        let now = sm2_io::clock::now();
        let [key, gateway_key] = [(); 2].map(|()| SecretKey::generate().unwrap());
        let gateway = gateway_key.id();
        let trusted = Trusted::default();
        trusted.set([key.id()]);
        let gateway_endpoint =
            Endpoint::new(gateway_key, trusted, Congestion::default(), Some([2; 32]));
        let config = Arc::new(EndpointConfig::default());
        let mut hand_endpoint = quinn_proto::Endpoint::new(config, None, true, Some([1; 32]));
        let tls = QuicClientConfig::try_from(honest_tls(&key)).unwrap();
        let mut config = quinn_proto::ClientConfig::new(Arc::new(tls));
        config.transport_config(Arc::new(transport));
        let addresses = [1, 2].map(|host| SocketAddr::from(([10, 0, 0, host], 7_633)));
        let quic = clock.at(now).quic;
        let hand = hand_endpoint.connect(quic, config, addresses[1], "gateway.invalid");
        let mut world = Self {
            now,
            clock,
            me: Me {
                hop: Hop { gateway, epoch: 1 },
                name: Name::new("gateway").unwrap(),
            },
            id: key.id(),
            addresses,
            hand: hand.unwrap(),
            hand_endpoint,
            gateway_endpoint: gateway_endpoint.unwrap(),
            gateway: None,
            limits,
            stopped: Vec::new(),
            closed: None,
        };
        world.exchange();
        assert!(world.gateway.is_some());
        world
    }

    /// A world where the gateway wants an offer of the hand.
    fn new(transport: TransportConfig) -> Self {
        Self::silent(transport).greeted().0
    }

    /// The same world, and the control stream.
    fn greeted(self) -> (Self, StreamId) {
        let mut world = self;
        world.pass(MOMENT);
        let control = world.hand.1.streams().open(Dir::Bi).unwrap();
        let hello = Frame::Hello {
            min_version: 1,
            max_version: 1,
            epoch: 1,
            name: Name::new("hand").unwrap(),
        };
        let offer = Frame::Offer {
            offer: OFFER,
            subject: topic("topic"),
            path: vec![Hop {
                gateway: world.id,
                epoch: 1,
            }],
        };
        world.write(control, &[hello.to_bytes(), offer.to_bytes()].concat());
        let depth = 1;
        let offer = OFFER;
        let want = ControlCommand::Want { offer, depth };
        world.feed(Input::Command(Command::Control(want)));
        world.pass(MOMENT);
        (world, control)
    }

    fn write(&mut self, stream: StreamId, bytes: &[u8]) {
        let written = self.hand.1.send_stream(stream).write(bytes);
        assert_eq!(written, Ok(bytes.len()));
        self.exchange();
    }

    /// Feeds the gateway and carries out its outputs.
    fn feed(&mut self, input: Input) {
        let Some((handle, peer)) = &mut self.gateway else {
            return;
        };
        let mut next = Some(input);
        while let Some(input) = next.take() {
            let Ok(()) = peer.handle(self.now, input);
            while let Some(output) = peer.poll() {
                if let Output::Endpoint(event) = output {
                    let answer = self.gateway_endpoint.event(*handle, event);
                    next = answer.map(Input::Quic).or(next);
                }
            }
        }
    }

    /// Delivers a datagram to the gateway.
    fn deliver_to_gateway(&mut self, bytes: &[u8]) {
        let (quic, mut answer) = (self.clock.at(self.now).quic, Vec::new());
        let endpoint = &mut self.gateway_endpoint;
        let arrival = endpoint.handle(quic, self.addresses[0], None, bytes, &mut answer);
        match arrival {
            Some(Arrival::New(handle, connection)) => {
                let (clock, me) = (self.clock, self.me.clone());
                let peer = Peer::new(*connection, clock, me, BTreeMap::new(), self.limits);
                self.gateway = Some((handle, peer));
            }
            Some(Arrival::Event(_, event)) => self.feed(Input::Quic(event)),
            Some(Arrival::Answer(_)) | None => {}
        }
    }

    /// Delivers a datagram to the hand.
    fn deliver_to_hand(&mut self, bytes: &[u8]) {
        let (quic, mut answer) = (self.clock.at(self.now).quic, Vec::new());
        let (from, bytes) = (self.addresses[1], BytesMut::from(bytes));
        let endpoint = &mut self.hand_endpoint;
        let arrival = endpoint.handle(quic, from, None, None, bytes, &mut answer);
        if let Some(DatagramEvent::ConnectionEvent(_, event)) = arrival {
            self.hand.1.handle_event(event);
        }
    }

    /// Exchanges all datagrams that are due now.
    fn exchange(&mut self) {
        let quic = self.clock.at(self.now).quic;
        let mut buffer = Vec::new();
        loop {
            buffer.clear();
            if let Some(sent) = self.hand.1.poll_transmit(quic, 1, &mut buffer) {
                self.deliver_to_gateway(&buffer[..sent.size]);
                continue;
            }
            let gateway = self.gateway.as_mut();
            if let Some(sent) =
                gateway.and_then(|(_, it)| it.poll_transmit(self.now, 1, &mut buffer))
            {
                self.deliver_to_hand(&buffer[..sent.size]);
                continue;
            }
            while let Some(event) = self.hand.1.poll() {
                self.happened(event);
            }
            let Some(event) = self.hand.1.poll_endpoint_events() else {
                return;
            };
            if let Some(answer) = self.hand_endpoint.handle_event(self.hand.0, event) {
                self.hand.1.handle_event(answer);
            }
        }
    }

    /// Takes an event of the hand.
    fn happened(&mut self, event: quinn_proto::Event) {
        match event {
            quinn_proto::Event::Stream(StreamEvent::Stopped { id, error_code }) => {
                self.stopped.push((id, error_code.into_inner()));
            }
            quinn_proto::Event::ConnectionLost { reason } => match reason {
                ConnectionError::ApplicationClosed(close) => {
                    self.closed = Some(close.error_code.into_inner());
                }
                other => panic!("{other:?}"),
            },
            _ => {}
        }
    }

    /// Lets this time pass.
    fn pass(&mut self, time: Duration) {
        let until = self.now.after(time);
        loop {
            self.exchange();
            let hand = self.hand.1.poll_timeout().map(|it| self.clock.of(it));
            let gateway = self.gateway.as_ref().and_then(|(_, it)| it.deadline());
            let next = hand.into_iter().chain(gateway).min();
            let Some(next) = next.filter(|it| *it <= until) else {
                self.now = until;
                return;
            };
            self.now = next.max(self.now);
            if hand.is_some_and(|it| it <= self.now) {
                self.hand.1.handle_timeout(self.clock.at(self.now).quic);
            }
            if gateway.is_some_and(|it| it <= self.now) {
                self.feed(Input::Tick);
            }
        }
    }

    fn refused(&self) -> u64 {
        let gateway = self.gateway.as_ref();
        gateway.map_or(0, |(_, it)| it.counts().refused)
    }
}

fn topic(name: &str) -> Subject {
    Subject::Topic {
        name: Name::new(name).unwrap(),
        data: TypeId {
            name: Name::new("bytes").unwrap(),
            hash: 0,
        },
        reliable: false,
        latched: 0,
    }
}

//= SM2-GWM-010 test
#[test]
fn a_stream_on_which_nothing_arrives_is_stopped() {
    let mut world = World::new(TransportConfig::default());
    let header = Header {
        kind: HeaderKind::Message {
            sequence: 1,
            age_ns: 0,
        },
        offer: OFFER,
        len: 100,
    };
    let message = [&header.to_bytes()[..], &[7; 100]].concat();
    let whole = world.hand.1.streams().open(Dir::Uni).unwrap();
    let begun = world.hand.1.streams().open(Dir::Uni).unwrap();
    world.write(whole, &message);
    world.hand.1.send_stream(whole).finish().unwrap();
    world.write(begun, &message[..50]);
    world.pass(SILENCE - MOMENT);
    assert_eq!(world.stopped, []);
    // Each byte begins the time again.
    world.write(begun, &message[50..51]);
    world.pass(SILENCE - MOMENT);
    assert_eq!((world.stopped.len(), world.refused()), (0, 0));
    world.pass(2 * MOMENT);
    let expired = u64::from(StreamEnd::Expired.code().0);
    assert_eq!(world.stopped, [(begun, expired)]);
    assert_eq!(world.refused(), 1);
}

/// The hand reads nothing, so messages that were started stay in memory. There is memory for what arrives all the same,
/// and both together take no more than they may.
#[test]
fn what_is_sent_and_what_arrives_have_one_limit() {
    const MEMORY_BYTES: usize = 1 << 20;
    const SENT_BYTES: usize = 20_000;
    const ARRIVING_BYTES: usize = 99_000;
    let limits = Limits {
        message_bytes: 1 << 20,
        memory_bytes: MEMORY_BYTES as u64,
        ..Limits::default()
    };
    let mut transport = TransportConfig::default();
    transport.stream_receive_window(VarInt::from_u32(1_000));
    let (mut world, control) = World::limited(transport, limits).greeted();
    for number in 1..=60 {
        let offer = OfferId(number);
        let subject = topic(&format!("topic{number}"));
        let (path, qos) = (vec![world.me.hop], DEFAULT_SEND_QOS);
        world.feed(Input::Command(Command::Offer {
            offer,
            subject,
            path,
            qos,
        }));
        world.pass(MOMENT);
        world.write(control, &Frame::Want { offer, depth: 1 }.to_bytes());
        let message = Message {
            sequence: 1,
            published_at: world.now,
            payload: Bytes::from(vec![0; SENT_BYTES]),
        };
        world.feed(Input::Command(Command::Message { offer, message }));
        world.pass(MOMENT);
    }
    let opened = world.hand.1.streams().remote_open_streams(Dir::Uni);
    let sent_bytes = usize::try_from(opened).unwrap() * SENT_BYTES;
    let half = MEMORY_BYTES / 2;
    assert!(
        (half - SENT_BYTES..=half).contains(&sent_bytes),
        "{sent_bytes} bytes"
    );
    let header = Header {
        kind: HeaderKind::Message {
            sequence: 1,
            age_ns: 0,
        },
        offer: OFFER,
        len: ARRIVING_BYTES as u64 + 1,
    };
    let message = [&header.to_bytes()[..], &[7; ARRIVING_BYTES]].concat();
    let mut begun = 0;
    while world.stopped.is_empty() {
        begun += 1;
        let stream = world.hand.1.streams().open(Dir::Uni).unwrap();
        world.write(stream, &message);
        world.pass(MOMENT);
    }
    let kept_bytes = (begun - 1) * ARRIVING_BYTES;
    let rest = MEMORY_BYTES - sent_bytes;
    assert!(
        (rest - ARRIVING_BYTES..=rest).contains(&kept_bytes),
        "{kept_bytes} bytes"
    );
    assert_eq!(world.closed, None);
}

//= SM2-GWF-001 test
#[test]
fn a_peer_that_does_not_greet_is_closed() {
    let mut world = World::silent(TransportConfig::default());
    world.pass(GREETING - MOMENT);
    assert_eq!(world.closed, None);
    world.pass(2 * MOMENT);
    let code = PeerFarewell::GreetingTimeout.code().0;
    assert_eq!(world.closed, Some(u64::from(code)));
}

/// 2,000 offers with names and types of 250 bytes fit into the stream of a peer that has room for them, and into the
/// 1 MiB of the gateway for a peer that reads nothing they do not.
//= SM2-GWF-003 test
#[test]
fn a_peer_that_does_not_read_the_control_stream_is_closed() {
    let stalled = u64::from(PeerFarewell::Stalled.code().0);
    for (window, closed) in [(8 << 20, None), (1_000, Some(stalled))] {
        let mut transport = TransportConfig::default();
        transport.stream_receive_window(VarInt::from_u32(window));
        let mut world = World::new(transport);
        for number in 0..2_000 {
            let command = Command::Offer {
                offer: OfferId(1 + number),
                subject: Subject::Topic {
                    name: Name::new(&format!("{}{number:04}", "n".repeat(246))).unwrap(),
                    data: TypeId {
                        name: Name::new(&"t".repeat(250)).unwrap(),
                        hash: 1,
                    },
                    reliable: false,
                    latched: 0,
                },
                path: vec![world.me.hop],
                qos: DEFAULT_SEND_QOS,
            };
            world.feed(Input::Command(command));
        }
        world.pass(MOMENT);
        assert_eq!(world.closed, closed, "a window of {window} bytes");
    }
}
