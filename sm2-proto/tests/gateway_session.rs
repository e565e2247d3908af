//! The session between gateways: each frame in each state, and two sessions with frames and streams
//! in flight between them.

// Shows GW-SESSION (proptest), bound: each frame in each state; the example of SPEC; sampled steps of two sessions,
// streams in any order.

mod calls;
mod example;
mod misuse;
mod offers;
mod pair;

use crate::support::contracts::{data, name};
use sm2_proto::{
    Error, Instant, Machine,
    gateway::{
        AskId, Frame, GatewayId, Header, HeaderKind, Hop, OfferId, PeerFarewell, PeerViolation,
        PeerViolationKind, StreamToken, Subject, SubjectKind, Verdict,
        session::{
            Candidate, Command, ControlCommand, End, Event, Initiator, Input, Misuse, Output,
            PeerEvent, PeerSession, Transport, older_stays,
        },
    },
    limits::QUESTIONS_MAX,
    violation,
};

const EPOCH: u64 = 70;
const ONE: OfferId = OfferId(1);

fn hop(gateway: u8) -> Hop {
    Hop {
        gateway: GatewayId([gateway; 32]),
        epoch: EPOCH + u64::from(gateway),
    }
}

fn session(me: u8, peer: u8) -> PeerSession {
    let start = Instant(0);
    PeerSession::new(start, hop(me), name("me"), hop(peer).gateway, 0)
}

fn hello(of: u8) -> Frame {
    Frame::Hello {
        min_version: 1,
        max_version: 9,
        epoch: hop(of).epoch,
        name: name("peer"),
    }
}

fn subject(kind: SubjectKind) -> Subject {
    match kind {
        SubjectKind::Topic => Subject::Topic {
            name: name("scan"),
            data: data("Scan"),
            reliable: false,
            latched: 0,
        },
        SubjectKind::Service => Subject::Service {
            name: name("add"),
            request: data("A"),
            reply: data("B"),
        },
    }
}

fn topic() -> Subject {
    subject(SubjectKind::Topic)
}

fn service() -> Subject {
    subject(SubjectKind::Service)
}

/// The session of gateway 1 with gateway 2.
struct Bench(PeerSession);

impl Bench {
    /// A session that has sent its HELLO and waits for that of the peer.
    fn greeting(mut session: PeerSession) -> Self {
        assert!(matches!(session.poll(), Some(Output::Transmit(_))));
        assert_eq!(session.poll(), None);
        Self(session)
    }

    /// A session after the HELLO of both sides.
    fn open() -> Self {
        let mut bench = Self::greeting(session(1, 2));
        let outputs = bench.frame(&hello(2));
        assert!(matches!(
            outputs[..],
            [Output::Event(Event::Greeted { .. })]
        ));
        bench
    }

    fn input(&mut self, input: Input<'_>) -> Vec<Output> {
        let taken = self.0.handle(Instant(0), input.clone());
        let outputs: Vec<Output> = std::iter::from_fn(|| self.0.poll()).collect();
        let judged = match outputs.last() {
            Some(Output::Ended(end @ End::Violation(_))) => Err(Error::Ended(*end)),
            _ => Ok(()),
        };
        assert_eq!(taken, judged, "{input:?}");
        outputs
    }

    fn frame(&mut self, frame: &Frame) -> Vec<Output> {
        self.input(Input::Event(PeerEvent::Control(&frame.to_bytes())))
    }

    fn misuse(&mut self, input: Input<'_>) -> Misuse {
        let before = self.0.clone();
        let answer = self.0.handle(Instant(0), input);
        assert_eq!(self.0, before);
        match answer {
            Err(Error::Misuse(misuse)) => misuse,
            other => panic!("{other:?} instead of a misuse"),
        }
    }

    /// The end that an ended session answers an input with.
    fn ended(&mut self, input: Input<'_>) -> End {
        match self.0.handle(Instant(0), input) {
            Err(Error::Ended(end)) => end,
            other => panic!("{other:?} instead of the end"),
        }
    }

    fn offer(&mut self, offer: OfferId, subject: Subject) {
        let path = vec![hop(1)];
        let outputs = self.input(Input::Command(Command::Offer {
            offer,
            subject: subject.clone(),
            path: path.clone(),
        }));
        let frame = Frame::Offer {
            offer,
            subject,
            path,
        };
        assert_eq!(outputs, [Output::Transmit(frame.to_bytes())]);
    }

    fn offered(&mut self, offer: OfferId, subject: Subject) {
        let path = vec![hop(3), hop(2)];
        let frame = Frame::Offer {
            offer,
            subject: subject.clone(),
            path: path.clone(),
        };
        let expected = Output::Event(Event::Offered {
            offer,
            subject,
            path,
        });
        assert_eq!(self.frame(&frame), [expected]);
    }

    fn stream(&mut self, kind: HeaderKind, offer: OfferId) -> Vec<Output> {
        let header = Header {
            kind,
            offer,
            len: 0,
        };
        self.input(Input::Event(PeerEvent::Header {
            transport: Transport::Stream(SEVEN),
            header,
        }))
    }
}

const MESSAGE: HeaderKind = HeaderKind::Message {
    sequence: 1,
    age_ns: 0,
};
const SEVEN: StreamToken = StreamToken(7);
const REQUEST: HeaderKind = HeaderKind::Request { left_ns: 0 };

fn ended(violation: PeerViolation) -> Vec<Output> {
    vec![Output::Ended(End::Violation(violation))]
}

fn transmit(frame: &Frame) -> Output {
    Output::Transmit(frame.to_bytes())
}

//= SM2-GWF-001 test
#[test]
fn greetings() {
    for (frame, expected) in [
        (
            Frame::Unwant { offer: ONE },
            violation!(PeerViolationKind::ExpectedHello, "SM2-GWF-001"),
        ),
        (
            Frame::Hello {
                min_version: 0,
                max_version: 1,
                epoch: 1,
                name: name("a"),
            },
            violation!(PeerViolationKind::BadVersionRange, "SM2-GWF-001"),
        ),
        (
            Frame::Hello {
                min_version: 2,
                max_version: 1,
                epoch: 1,
                name: name("a"),
            },
            violation!(PeerViolationKind::BadVersionRange, "SM2-GWF-001"),
        ),
    ] {
        let mut bench = Bench::greeting(session(1, 2));
        assert_eq!(bench.frame(&frame), ended(expected));
    }
    let mut newer = Bench::greeting(session(1, 2));
    let outputs = newer.frame(&Frame::Hello {
        min_version: 2,
        max_version: 3,
        epoch: 1,
        name: name("a"),
    });
    let version = PeerFarewell::Version.code();
    assert_eq!(outputs, [Output::Ended(End::Local(version))]);
    let mut twice = Bench::open();
    assert_eq!(
        twice.frame(&hello(2)),
        ended(violation!(
            PeerViolationKind::UnexpectedHello,
            "SM2-GWF-001"
        ))
    );
    // A stream before HELLO is the same violation.
    let mut first = Bench::greeting(session(1, 2));
    assert_eq!(
        first.stream(MESSAGE, ONE),
        ended(violation!(PeerViolationKind::ExpectedHello, "SM2-GWF-001"))
    );
    let end = End::Violation(violation!(PeerViolationKind::ExpectedHello, "SM2-GWF-001"));
    assert_eq!(first.0.end(), Some(end));
    assert_eq!(first.ended(Input::Tick), end);
}

//= SM2-GWF-001 test
#[test]
fn a_peer_that_does_not_greet() {
    let mut bench = session(1, 2);
    let deadline = Instant(2_000_000_000);
    assert_eq!(bench.deadline(), Some(deadline));
    bench.poll();
    bench.handle(Instant(deadline.0 - 1), Input::Tick).unwrap();
    assert_eq!(bench.poll(), None);
    bench.handle(deadline, Input::Tick).unwrap();
    let late = PeerFarewell::GreetingTimeout.code();
    assert_eq!(bench.poll(), Some(Output::Ended(End::Local(late))));
    let mut open = Bench::open();
    assert_eq!(open.0.deadline(), None);
    open.0.handle(deadline, Input::Tick).unwrap();
    assert_eq!(open.0.poll(), None);
}

#[test]
fn a_process_that_was_before() {
    for (least, is_stale) in [(0, false), (72, false), (73, true)] {
        let me = hop(1);
        let session = PeerSession::new(Instant(0), me, name("me"), hop(2).gateway, least);
        let mut bench = Bench::greeting(session);
        let last = bench.frame(&hello(2)).pop().unwrap();
        if is_stale {
            let stale = PeerFarewell::Stale.code();
            assert_eq!(last, Output::Ended(End::Local(stale)));
        } else {
            let (epoch, name) = (72, name("peer"));
            let peer = hop(2).gateway;
            assert_eq!(last, Output::Event(Event::Greeted { peer, epoch, name }));
        }
    }
}

//= SM2-GWC-004 test
#[test]
fn of_two_connections_both_sides_keep_the_same() {
    use Initiator::{Peer, ThisGateway};
    let (small, great) = (hop(1).gateway, hop(2).gateway);
    let by = |epoch, initiator| Candidate { epoch, initiator };
    for (first, second) in [(ThisGateway, Peer), (Peer, ThisGateway)] {
        // The epochs are equal: the connection that the smaller id opened stays.
        let at_small = older_stays(small, great, by(5, first), by(5, second));
        let at_great = older_stays(great, small, by(9, second), by(9, first));
        let opened_by_small = first == ThisGateway;
        assert_eq!((at_small, at_great), (opened_by_small, opened_by_small));
        // The newer process of the peer wins, whichever side opened the connection.
        assert!(older_stays(small, great, by(6, first), by(5, second)));
        assert!(!older_stays(small, great, by(5, first), by(6, second)));
    }
    let same = by(5, ThisGateway);
    assert!(older_stays(small, great, same, same), "a tie");
}

//= SM2-GWO-006 test
#[test]
fn questions() {
    let kind = SubjectKind::Topic;
    let ask = |ask| Frame::Ask {
        ask,
        kind,
        name: name("a"),
    };
    let answer = |ask, verdict| Frame::Answer { ask, verdict };
    let mut bench = Bench::open();
    // The peer chooses the numbers of its questions freely.
    for number in [4, 1, 4] {
        let asked = Output::Event(Event::Asked {
            ask: AskId(number),
            kind,
            name: name("a"),
        });
        assert_eq!(bench.frame(&ask(AskId(number))), [asked]);
    }
    let verdict = Verdict::Denied;
    let wrong = Input::Command(Command::Control(ControlCommand::Answer {
        ask: AskId(1),
        verdict,
    }));
    assert_eq!(bench.misuse(wrong), Misuse::NotAsked);
    for number in [4, 1, 4] {
        let outputs = bench.input(Input::Command(Command::Control(ControlCommand::Answer {
            ask: AskId(number),
            verdict,
        })));
        assert_eq!(outputs, [transmit(&answer(AskId(number), verdict))]);
    }
    for number in 0..QUESTIONS_MAX as u64 {
        bench.frame(&ask(AskId(number)));
    }
    assert_eq!(
        bench.frame(&ask(AskId(0))),
        ended(violation!(PeerViolationKind::Malformed, "SM2-GWO-006"))
    );
    let mut bench = Bench::open();
    for number in 0..QUESTIONS_MAX as u64 {
        let name = name("a");
        let asked = bench.input(Input::Command(Command::Control(ControlCommand::Ask {
            ask: AskId(number),
            kind,
            name,
        })));
        assert_eq!(asked, [transmit(&ask(AskId(number)))]);
    }
    let one_more = Input::Command(Command::Control(ControlCommand::Ask {
        ask: AskId(9),
        kind,
        name: name("a"),
    }));
    assert_eq!(bench.misuse(one_more), Misuse::TooManyQuestions);
    let answered = Output::Event(Event::Answered {
        ask: AskId(0),
        verdict,
    });
    assert_eq!(bench.frame(&answer(AskId(0), verdict)), [answered]);
    let refused = ended(violation!(
        PeerViolationKind::UnexpectedAnswer,
        "SM2-GWO-006"
    ));
    assert_eq!(bench.frame(&answer(AskId(0), verdict)), refused);
}

#[test]
fn both_ways_to_end_it() {
    let code = PeerFarewell::ShuttingDown.code();
    for input in [Input::Close(code), Input::Event(PeerEvent::Closed(None))] {
        let mut bench = Bench::open();
        let end = match input {
            Input::Close(code) => End::Local(code),
            _ => End::Closed(None),
        };
        assert_eq!(bench.input(input), [Output::Ended(end)]);
        assert_eq!(bench.0.end(), Some(end));
        assert_eq!(bench.ended(Input::Event(PeerEvent::Control(&[1]))), end);
    }
    // The session reads no frame behind the one that ended it.
    let mut bench = Bench::open();
    let bytes = [hello(2).to_bytes(), hello(2).to_bytes()].concat();
    let outputs = bench.input(Input::Event(PeerEvent::Control(&bytes)));
    assert_eq!(
        outputs,
        ended(violation!(
            PeerViolationKind::UnexpectedHello,
            "SM2-GWF-001"
        ))
    );
}
