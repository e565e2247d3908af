//! A stream of which a part arrives and then nothing more, in virtual time.

use std::{collections::BTreeMap, net::SocketAddr, time::Duration};

use quinn_proto::{Connection, ConnectionHandle, Dir, StreamEvent, StreamId};
use sm2_gateway::{
    clock::Clock,
    peer::{Command, Input, Limits, Me, Output, Peer},
};
use sm2_io::quic::{Arrival, Congestion, Endpoint, SecretKey, Trusted};
use sm2_proto::{
    Instant, Machine, Name, TypeId,
    gateway::{
        Frame, Header, HeaderKind, Hop, OfferId, StreamEnd, Subject, session::ControlCommand,
    },
};

/// A stream on which nothing arrives for this time is stopped.
const SILENCE: Duration = Duration::from_secs(30);
const MOMENT: Duration = Duration::from_millis(100);
const OFFER: OfferId = OfferId(1);

/// A gateway, and a peer that the test drives by hand. Datagrams need no time.
struct World {
    now: Instant,
    clock: Clock,
    me: Me,
    endpoints: [Endpoint; 2],
    addresses: [SocketAddr; 2],
    hand: (ConnectionHandle, Connection),
    gateway: Option<(ConnectionHandle, Peer)>,
    /// The streams that the gateway has stopped, with its codes.
    stopped: Vec<(StreamId, u64)>,
}

impl World {
    /// A world in which the gateway wants an offer of the hand.
    fn new() -> Self {
        let clock = Clock::of_the_machine();
        let now = sm2_io::clock::now();
        let keys = [(); 2].map(|()| SecretKey::generate().unwrap());
        let ids = [keys[0].id(), keys[1].id()];
        let trusted = Trusted::default();
        trusted.set(ids.iter().copied());
        let mut seed = 0;
        let mut endpoints = keys.map(|key| {
            seed += 1;
            Endpoint::new(
                key,
                trusted.clone(),
                Congestion::default(),
                Some([seed; 32]),
            )
            .unwrap()
        });
        let addresses = [1, 2].map(|host| SocketAddr::from(([10, 0, 0, host], 7_633)));
        let hop = |gateway| Hop { gateway, epoch: 1 };
        let hand = endpoints[0].connect(clock.at(now).quic, ids[1], addresses[1]);
        let mut world = Self {
            now,
            clock,
            me: Me {
                hop: hop(ids[1]),
                name: Name::new("gateway").unwrap(),
            },
            endpoints,
            addresses,
            hand: hand.unwrap(),
            gateway: None,
            stopped: Vec::new(),
        };
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
            subject: Subject::Topic {
                name: Name::new("topic").unwrap(),
                data: TypeId {
                    name: Name::new("bytes").unwrap(),
                    hash: 0,
                },
                reliable: false,
                latched: 0,
            },
            path: vec![hop(ids[0])],
        };
        world.write(control, &[hello.to_bytes(), offer.to_bytes()].concat());
        let depth = 1;
        let offer = OFFER;
        let want = ControlCommand::Want { offer, depth };
        world.feed(Input::Command(Command::Control(want)));
        world.pass(MOMENT);
        world
    }

    fn write(&mut self, stream: StreamId, bytes: &[u8]) {
        let written = self.hand.1.send_stream(stream).write(bytes);
        assert_eq!(written, Ok(bytes.len()));
        self.settle();
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
                    let answer = self.endpoints[1].event(*handle, event);
                    next = answer.map(Input::Quic).or(next);
                }
            }
        }
    }

    /// Delivers a datagram to the gateway.
    fn deliver_to_gateway(&mut self, bytes: &[u8]) {
        let (quic, mut answer) = (self.clock.at(self.now).quic, Vec::new());
        let arrival = self.endpoints[1].handle(quic, self.addresses[0], None, bytes, &mut answer);
        match arrival {
            Some(Arrival::New(handle, connection)) => {
                let (clock, me) = (self.clock, self.me.clone());
                let peer = Peer::new(*connection, clock, me, BTreeMap::new(), Limits::default());
                self.gateway = Some((handle, peer));
            }
            Some(Arrival::Event(_, event)) => self.feed(Input::Quic(event)),
            Some(Arrival::Answer(_)) | None => {}
        }
    }

    /// Delivers a datagram to the hand.
    fn deliver_to_hand(&mut self, bytes: &[u8]) {
        let (quic, mut answer) = (self.clock.at(self.now).quic, Vec::new());
        let arrival = self.endpoints[0].handle(quic, self.addresses[1], None, bytes, &mut answer);
        if let Some(Arrival::Event(_, event)) = arrival {
            self.hand.1.handle_event(event);
        }
    }

    /// Exchanges all datagrams that are due now.
    fn settle(&mut self) {
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
                if let quinn_proto::Event::Stream(StreamEvent::Stopped { id, error_code }) = event {
                    self.stopped.push((id, error_code.into_inner()));
                }
            }
            let Some(event) = self.hand.1.poll_endpoint_events() else {
                return;
            };
            if let Some(answer) = self.endpoints[0].event(self.hand.0, event) {
                self.hand.1.handle_event(answer);
            }
        }
    }

    /// Lets this time pass.
    fn pass(&mut self, time: Duration) {
        let until = self.now.after(time);
        loop {
            self.settle();
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

//= SM2-GWM-011 test
#[test]
fn a_stream_on_which_nothing_arrives_is_stopped() {
    let mut world = World::new();
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
