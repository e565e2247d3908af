//! Two sessions with frames and streams in flight between them.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Instant, Machine,
    gateway::{
        Header, HeaderKind, OfferId, Outcome, StreamToken, SubjectKind,
        session::{
            Command, ControlCommand, Event, Input, Output, PeerEvent, PeerSession, Transport,
        },
    },
};

use super::{MESSAGE, REQUEST, hop, session, subject};
use crate::support::cases;

/// Two sessions. Bytes of the control stream arrive in order, other streams in any order.
struct Pair {
    sides: [PeerSession; 2],
    control: [VecDeque<u8>; 2],
    streams: [Vec<(StreamToken, Header)>; 2],
    offers: [BTreeMap<OfferId, SubjectKind>; 2],
    /// The offers that each side knows, and those of them that it wants.
    known: [BTreeMap<OfferId, SubjectKind>; 2],
    wanting: [BTreeSet<OfferId>; 2],
    /// The offers of each side that its peer wants, as far as the side knows.
    wanted: [BTreeSet<OfferId>; 2],
    calls: [BTreeSet<StreamToken>; 2],
    next: u64,
}

impl Pair {
    fn new() -> Self {
        let mut pair = Self {
            sides: [session(1, 2), session(2, 1)],
            control: Default::default(),
            streams: Default::default(),
            offers: Default::default(),
            known: Default::default(),
            wanting: Default::default(),
            wanted: Default::default(),
            calls: Default::default(),
            next: 0,
        };
        pair.drain(0);
        pair.drain(1);
        pair
    }

    fn drain(&mut self, side: usize) {
        while let Some(output) = self.sides[side].poll() {
            match output {
                Output::Transmit(bytes) => self.control[1 - side].extend(bytes),
                Output::Event(Event::Greeted { epoch, .. }) => {
                    assert_eq!(epoch, hop(2 - side as u8).epoch)
                }
                Output::Event(Event::Offered { offer, subject, .. }) => {
                    let before = self.known[side].insert(offer, subject.kind());
                    assert_eq!(before, None);
                }
                Output::Event(Event::Gone { offer }) => {
                    assert!(self.known[side].remove(&offer).is_some());
                    self.wanting[side].remove(&offer);
                }
                Output::Event(Event::Wanted { offer, .. }) => {
                    assert!(self.wanted[side].insert(offer))
                }
                Output::Event(Event::Unwanted { offer }) => {
                    assert!(self.wanted[side].remove(&offer))
                }
                Output::CallFailed { stream } => assert!(self.calls[side].remove(&stream)),
                Output::Ended(end) => panic!("an honest pair: {end:?}"),
                other => panic!("{other:?}"),
            }
        }
    }

    fn input(&mut self, side: usize, input: Input<'_>) -> bool {
        let is_taken = self.sides[side].handle(Instant(0), input).is_ok();
        self.drain(side);
        is_taken
    }

    /// Feeds some of the bytes that are in flight.
    fn read(&mut self, side: usize, most: usize) {
        let count = most.min(self.control[side].len());
        let bytes: Vec<u8> = self.control[side].drain(..count).collect();
        assert!(self.input(side, Input::Event(PeerEvent::Control(&bytes))));
    }

    /// Delivers the header of a stream. A request is answered at once.
    fn stream(&mut self, side: usize, pick: usize) {
        if self.streams[side].is_empty() {
            return;
        }
        let pick = pick % self.streams[side].len();
        let (stream, header) = self.streams[side].remove(pick);
        let is_reply = matches!(header.kind, HeaderKind::Reply { .. });
        if is_reply && !self.calls[side].remove(&stream) {
            return;
        }
        let judged = self.sides[side].handle(
            Instant(0),
            Input::Event(PeerEvent::Header {
                transport: Transport::Stream(stream),
                header,
            }),
        );
        judged.unwrap();
        let output = self.sides[side].poll().unwrap();
        let offer = header.offer;
        match header.kind {
            HeaderKind::Message { .. } => {
                let expected = match self.wanting[side].contains(&offer) {
                    true => Output::Take {
                        transport: Transport::Stream(stream),
                    },
                    false => Output::Discard {
                        transport: Transport::Stream(stream),
                    },
                };
                assert_eq!(output, expected);
            }
            HeaderKind::Request { .. } => {
                let status = match self.wanted[side].contains(&offer)
                    && self.offers[side].contains_key(&offer)
                {
                    true => Outcome::Ok,
                    false => Outcome::Unreachable,
                };
                let is_taken = output
                    == Output::Take {
                        transport: Transport::Stream(stream),
                    };
                assert_eq!(is_taken, status == Outcome::Ok, "{output:?}");
                let kind = HeaderKind::Reply { status };
                self.streams[1 - side].push((stream, Header { kind, ..header }));
            }
            HeaderKind::Reply { .. } => assert_eq!(
                output,
                Output::Take {
                    transport: Transport::Stream(stream)
                }
            ),
        }
        self.drain(side);
    }

    /// Sends a message or a request that is legal now.
    fn send(&mut self, side: usize, pick: usize) {
        self.next += 1;
        let message = |it: &&OfferId| self.offers[side].get(it) == Some(&SubjectKind::Topic);
        let messages: Vec<OfferId> = self.wanted[side].iter().filter(message).copied().collect();
        let service = |it: &&OfferId| self.known[side][it] == SubjectKind::Service;
        let calls: Vec<OfferId> = self.wanting[side].iter().filter(service).copied().collect();
        let stream = StreamToken(self.next);
        let (kind, offer) = match (messages.len(), calls.len()) {
            (0, 0) => return,
            (_, 0) => (MESSAGE, messages[pick % messages.len()]),
            (_, count) => {
                let offer = calls[pick % count];
                if !self.input(side, Input::Command(Command::Call { stream, offer })) {
                    // The service is wanted again, but UNWANTED has not come yet.
                    return;
                }
                self.calls[side].insert(stream);
                (REQUEST, offer)
            }
        };
        let header = Header {
            kind,
            offer,
            len: 0,
        };
        self.streams[1 - side].push((stream, header));
    }

    fn step(&mut self, op: u8, side: usize, pick: usize) {
        let some = |set: Vec<OfferId>| (!set.is_empty()).then(|| set[pick % set.len()]);
        match op {
            0 => {
                self.next += 1;
                let kind = [SubjectKind::Topic, SubjectKind::Service][pick % 2];
                let (offer, path) = (OfferId(self.next), vec![hop(1 + side as u8)]);
                let subject = subject(kind);
                let made = self.input(
                    side,
                    Input::Command(Command::Offer {
                        offer,
                        subject,
                        path,
                    }),
                );
                if made {
                    self.offers[side].insert(offer, kind);
                }
            }
            1 => {
                if let Some(offer) = some(self.offers[side].keys().copied().collect()) {
                    assert!(self.input(
                        side,
                        Input::Command(Command::Control(ControlCommand::Unoffer { offer }))
                    ));
                    self.offers[side].remove(&offer);
                    self.wanted[side].remove(&offer);
                }
            }
            2 => {
                let is_free = |it: &&OfferId| !self.wanting[side].contains(it);
                if let Some(offer) =
                    some(self.known[side].keys().filter(is_free).copied().collect())
                {
                    assert!(self.input(
                        side,
                        Input::Command(Command::Control(ControlCommand::Want { offer, depth: 1 }))
                    ));
                    self.wanting[side].insert(offer);
                }
            }
            3 => {
                if let Some(offer) = some(self.wanting[side].iter().copied().collect()) {
                    assert!(self.input(
                        side,
                        Input::Command(Command::Control(ControlCommand::Unwant { offer }))
                    ));
                    self.wanting[side].remove(&offer);
                }
            }
            4 | 5 => self.read(side, pick),
            6 => self.send(side, pick),
            _ => self.stream(side, pick),
        }
    }
}

proptest! {
    #![proptest_config(cases(600))]

    /// No order of legal steps ends a connection. When everything has arrived, both sides agree.
    //= SM2-GWO-001, SM2-GWO-002, SM2-GWM-001, SM2-GWS-001, SM2-GWS-002 test
    #[test]
    fn honest_peers_agree(ops in vec((0_u8..9, 0_usize..2, 0_usize..60), 0..300)) {
        let mut pair = Pair::new();
        for (op, side, pick) in ops {
            pair.step(op, side, pick);
        }
        while (0..2).any(|side| !pair.control[side].is_empty() || !pair.streams[side].is_empty()) {
            for side in [0, 1] {
                pair.read(side, usize::MAX);
                pair.stream(side, 0);
            }
        }
        for side in [0, 1] {
            prop_assert_eq!(&pair.known[1 - side], &pair.offers[side]);
            prop_assert_eq!(&pair.wanting[1 - side], &pair.wanted[side]);
            prop_assert!(pair.calls[side].is_empty());
        }
    }
}
