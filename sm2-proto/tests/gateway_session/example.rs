//! The exchange of SPEC, Annex B.10, between two sessions. They send exactly the listed bytes.

use std::collections::VecDeque;

use sm2_proto::{
    Instant, Machine, TypeId,
    gateway::{
        GatewayId, Header, HeaderKind, Hop, StreamToken, Subject,
        session::{Command, ControlCommand, Input, Output, PeerEvent, PeerSession, Transport},
    },
};

use super::{ONE, name};

const SPEC: &str = include_str!("../../../SPEC.md");
const A: usize = 0;
const B: usize = 1;

/// The sending side, and its bytes.
type Sent = (usize, Vec<u8>);

/// The lines of the example. A line without a side continues the one before.
fn example() -> Vec<Sent> {
    let (_, rest) = SPEC.split_once("The bytes of this exchange").expect("B.10");
    let (_, rest) = rest.split_once("```text\n").expect("a block of text");
    let (block, _) = rest.split_once("```").expect("its end");
    let mut sent: Vec<Sent> = Vec::new();
    for line in block.lines() {
        let (bytes, _) = line.split_once('#').expect("a comment");
        let mut words = bytes.split_whitespace().peekable();
        if let Some(side) = words.next_if(|word| ["A", "B"].contains(word)) {
            sent.push((usize::from(side == "B"), Vec::new()));
        }
        let (_, bytes) = sent.last_mut().expect("the first line names a side");
        bytes.extend(words.map(|it| u8::from_str_radix(it, 16).expect("two digits")));
    }
    sent
}

const fn hop(side: usize) -> Hop {
    Hop {
        gateway: GatewayId([1 + side as u8; 32]),
        epoch: 71 + side as u64,
    }
}

struct Exchange {
    sides: [PeerSession; 2],
    sent: Vec<Sent>,
}

impl Exchange {
    fn new() -> Self {
        let session = |side: usize, called| {
            let peer = hop(1 - side).gateway;
            PeerSession::new(Instant(0), hop(side), name(called), peer, 0)
        };
        let mut exchange = Self {
            sides: [session(A, "a"), session(B, "b")],
            sent: Vec::new(),
        };
        let hellos = [A, B].map(|side| exchange.drain(side));
        for (side, hello) in hellos.into_iter().enumerate() {
            exchange.deliver(hello.into_iter().map(|bytes| (side, bytes)).collect());
        }
        exchange
    }

    /// The bytes that a session sends. It is drained afterwards.
    fn drain(&mut self, side: usize) -> Vec<Vec<u8>> {
        let outputs = std::iter::from_fn(|| self.sides[side].poll());
        let bytes = outputs.filter_map(|output| match output {
            Output::Transmit(bytes) => Some(bytes),
            _ => None,
        });
        bytes.collect()
    }

    /// Delivers bytes of the control stream, and the answers to them.
    fn deliver(&mut self, mut in_flight: VecDeque<Sent>) {
        while let Some((from, bytes)) = in_flight.pop_front() {
            let to = 1 - from;
            let control = Input::Event(PeerEvent::Control(&bytes));
            assert_eq!(self.sides[to].handle(Instant(0), control), Ok(()));
            self.sent.push((from, bytes));
            in_flight.extend(self.drain(to).into_iter().map(|bytes| (to, bytes)));
        }
    }

    fn command(&mut self, side: usize, command: Command) {
        let input = Input::Command(command);
        assert_eq!(self.sides[side].handle(Instant(0), input), Ok(()));
        let sent = self.drain(side).into_iter().map(|bytes| (side, bytes));
        self.deliver(sent.collect());
    }

    /// A message of offer 1, from A to B.
    fn message(&mut self) {
        let header = Header {
            kind: HeaderKind::Message {
                sequence: 1,
                age_ns: 1_000,
            },
            offer: ONE,
            len: 5,
        };
        self.sent.push((A, header.to_bytes().to_vec()));
        let transport = Transport::Stream(StreamToken(7));
        let event = PeerEvent::Header { transport, header };
        assert_eq!(
            self.sides[B].handle(Instant(0), Input::Event(event)),
            Ok(())
        );
        assert_eq!(self.sides[B].poll(), Some(Output::Take { transport }));
    }
}

#[test]
fn the_example_of_spec() {
    let subject = Subject::Topic {
        name: name("scan"),
        data: TypeId {
            name: name("Scan"),
            hash: 7,
        },
        reliable: false,
        latched: 0,
    };
    let want = || {
        Command::Control(ControlCommand::Want {
            offer: ONE,
            depth: 4,
        })
    };
    let mut exchange = Exchange::new();
    let offer = Command::Offer {
        offer: ONE,
        subject,
        path: vec![hop(A)],
    };
    exchange.command(A, offer);
    exchange.command(B, want());
    exchange.message();
    exchange.command(B, Command::Control(ControlCommand::Unwant { offer: ONE }));
    exchange.command(B, want());
    exchange.command(A, Command::Control(ControlCommand::Unoffer { offer: ONE }));
    assert_eq!(exchange.sent, example());
}
