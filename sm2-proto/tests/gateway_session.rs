//! A connection between gateways: each frame in each state, and two of them with all that can
//! be underway between them.

#[path = "gateway_session/pair.rs"]
mod pair;
mod support;

use sm2_proto::{
    Code, Instant,
    gateway::{
        Carried, Frame, GatewayId, Header, Hop, Outcome, PeerFarewell, PeerViolation, Subject,
        SubjectKind, Verdict,
        session::{End, Input, Misuse, Output, Session, first_stays},
    },
    limits::{OFFERS_MAX, QUESTIONS_MAX},
};
use support::contracts::{data, name};

const EPOCH: u64 = 70;

fn hop(gateway: u8) -> Hop {
    Hop {
        gateway: GatewayId([gateway; 32]),
        epoch: EPOCH + u64::from(gateway),
    }
}

fn session(me: u8, peer: u8) -> Session {
    let start = Instant(0);
    Session::new(start, hop(me), name("me"), hop(peer).gateway, 0)
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

/// Session 1 with peer 2.
struct Bench(Session);

impl Bench {
    /// After both HELLO.
    fn open() -> Self {
        let mut bench = Self(session(1, 2));
        let outputs = bench.frame(&hello(2));
        assert!(matches!(
            outputs[..],
            [Output::Transmit(_), Output::Greeted { .. }]
        ));
        bench
    }

    fn input(&mut self, input: Input<'_>) -> Vec<Output> {
        let taken = self.0.handle(Instant(0), input.clone());
        taken.unwrap_or_else(|misuse| panic!("{input:?}: {misuse}"));
        std::iter::from_fn(|| self.0.poll()).collect()
    }

    fn frame(&mut self, frame: &Frame) -> Vec<Output> {
        self.input(Input::Control(&frame.to_bytes()))
    }

    fn misuse(&mut self, input: Input<'_>) -> Misuse {
        let before = self.0.clone();
        let misuse = self.0.handle(Instant(0), input).expect_err("misuse");
        assert_eq!(self.0, before);
        misuse
    }

    fn offer(&mut self, offer: u64, subject: Subject) {
        let path = vec![hop(1)];
        let outputs = self.input(Input::Offer {
            offer,
            subject: subject.clone(),
            path: path.clone(),
        });
        let frame = Frame::Offer {
            offer,
            subject,
            path,
        };
        assert_eq!(outputs, [Output::Transmit(frame.to_bytes())]);
    }

    fn offered(&mut self, offer: u64, subject: Subject) {
        let path = vec![hop(3), hop(2)];
        let frame = Frame::Offer {
            offer,
            subject: subject.clone(),
            path: path.clone(),
        };
        let expected = Output::Offered {
            offer,
            subject,
            path,
        };
        assert_eq!(self.frame(&frame), [expected]);
    }

    fn stream(&mut self, carried: Carried, offer: u64) -> Vec<Output> {
        let header = Header {
            carried,
            offer,
            len: 0,
        };
        self.input(Input::Stream { stream: 7, header })
    }
}

const MESSAGE: Carried = Carried::Message {
    sequence: 1,
    age_ns: 0,
};
const REQUEST: Carried = Carried::Request { left_ns: 0 };
const REPLY: Carried = Carried::Reply {
    status: Outcome::Ok,
};

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
        (Frame::Unwant { offer: 1 }, PeerViolation::ExpectedHello),
        (
            Frame::Hello {
                min_version: 0,
                max_version: 1,
                epoch: 1,
                name: name("a"),
            },
            PeerViolation::BadVersionRange,
        ),
        (
            Frame::Hello {
                min_version: 2,
                max_version: 1,
                epoch: 1,
                name: name("a"),
            },
            PeerViolation::BadVersionRange,
        ),
    ] {
        let mut bench = Bench(session(1, 2));
        bench.0.poll();
        assert_eq!(bench.frame(&frame), ended(expected));
    }
    let mut newer = Bench(session(1, 2));
    newer.0.poll();
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
        ended(PeerViolation::UnexpectedHello)
    );
    // A stream that is there first is no better.
    let mut first = Bench(session(1, 2));
    first.0.poll();
    assert_eq!(
        first.stream(MESSAGE, 1),
        ended(PeerViolation::ExpectedHello)
    );
    let end = End::Violation(PeerViolation::ExpectedHello);
    assert_eq!(first.0.end(), Some(end));
    assert_eq!(first.misuse(Input::Tick), Misuse::Ended);
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
        let session = Session::new(Instant(0), me, name("me"), hop(2).gateway, least);
        let mut bench = Bench(session);
        let last = bench.frame(&hello(2)).pop().unwrap();
        if is_stale {
            let stale = PeerFarewell::Stale.code();
            assert_eq!(last, Output::Ended(End::Local(stale)));
        } else {
            let (epoch, name) = (72, name("peer"));
            assert_eq!(last, Output::Greeted { epoch, name });
        }
    }
}

#[test]
fn of_two_connections_both_sides_keep_the_same() {
    let (small, great) = (hop(1).gateway, hop(2).gateway);
    for by_small in [true, false] {
        // Of one process: the one that the smaller id opened.
        let first = first_stays(small, great, (5, by_small), (5, !by_small));
        let at_the_other = first_stays(great, small, (9, !by_small), (9, by_small));
        assert_eq!((first, at_the_other), (by_small, by_small));
        // The newer process, whoever opened it.
        assert!(first_stays(small, great, (6, by_small), (5, !by_small)));
        assert!(!first_stays(small, great, (5, by_small), (6, !by_small)));
    }
    assert!(first_stays(small, great, (5, true), (5, true)), "the first");
}

/// The table of the side that offers, in SPEC section 14.3.
//= SM2-GWO-002 test
#[test]
fn what_the_peer_says_of_our_offers() {
    let want = Frame::Want { offer: 1, depth: 3 };
    let unwant = Frame::Unwant { offer: 1 };
    let unoffered = Frame::Unoffered { offer: 1 };
    let unknown = || ended(PeerViolation::UnknownOffer);
    let wanted = || vec![Output::Wanted { offer: 1, depth: 3 }];
    let unwanted = || {
        let answer = Frame::Unwanted { offer: 1 };
        vec![transmit(&answer), Output::Unwanted { offer: 1 }]
    };
    let none = || unknown();
    let table: [(&str, [Vec<Output>; 3]); 4] = [
        ("offered", [wanted(), unknown(), unknown()]),
        (
            "wanted",
            [ended(PeerViolation::BadWant), unwanted(), unknown()],
        ),
        ("withdrawing", [vec![], vec![], vec![]]),
        ("gone", [none(), none(), none()]),
    ];
    for (state, row) in table {
        for (frame, expected) in [&want, &unwant, &unoffered].into_iter().zip(row) {
            let mut bench = Bench::open();
            bench.offer(1, topic());
            if state == "wanted" {
                bench.frame(&want);
            }
            if ["withdrawing", "gone"].contains(&state) {
                let outputs = bench.input(Input::Unoffer { offer: 1 });
                assert_eq!(outputs, [transmit(&Frame::Unoffer { offer: 1 })]);
            }
            if state == "gone" {
                assert_eq!(bench.frame(&unoffered), []);
            }
            assert_eq!(bench.frame(frame), expected, "{state}: {frame:?}");
        }
    }
    let mut bench = Bench::open();
    assert_eq!(bench.frame(&want), unknown(), "never offered");
}

/// The table of the side that it is offered to, and messages.
//= SM2-GWO-002, SM2-GWM-001 test
#[test]
fn what_the_peer_says_of_its_offers() {
    let unoffer = Frame::Unoffer { offer: 1 };
    let unwanted = Frame::Unwanted { offer: 1 };
    let unknown = || ended(PeerViolation::UnknownOffer);
    let not_wanted = || ended(PeerViolation::NotWanted);
    let gone = || {
        let answer = Frame::Unoffered { offer: 1 };
        vec![transmit(&answer), Output::Gone { offer: 1 }]
    };
    let take = || vec![Output::Take { stream: 7 }];
    let discard = || vec![Output::Discard { stream: 7 }];
    let table: [(&str, [Vec<Output>; 3]); 5] = [
        ("known", [gone(), unknown(), not_wanted()]),
        ("wanting", [gone(), unknown(), take()]),
        ("unwanting", [gone(), vec![], discard()]),
        ("known again", [gone(), unknown(), discard()]),
        ("gone", [unknown(), unknown(), discard()]),
    ];
    for (state, row) in table {
        for (index, expected) in row.into_iter().enumerate() {
            let mut bench = Bench::open();
            bench.offered(1, topic());
            if ["wanting", "unwanting", "known again"].contains(&state) {
                let frame = Frame::Want { offer: 1, depth: 2 };
                let outputs = bench.input(Input::Want { offer: 1, depth: 2 });
                assert_eq!(outputs, [transmit(&frame)]);
            }
            if ["unwanting", "known again"].contains(&state) {
                let outputs = bench.input(Input::Unwant { offer: 1 });
                assert_eq!(outputs, [transmit(&Frame::Unwant { offer: 1 })]);
            }
            match state {
                "known again" => assert_eq!(bench.frame(&unwanted), []),
                "gone" => assert_eq!(bench.frame(&unoffer), gone()),
                _ => {}
            }
            let outputs = match index {
                0 => bench.frame(&unoffer),
                1 => bench.frame(&unwanted),
                _ => bench.stream(MESSAGE, 1),
            };
            assert_eq!(outputs, expected, "{state}: {index}");
        }
    }
    for offer in [0, 2] {
        let mut bench = Bench::open();
        bench.offered(1, topic());
        assert_eq!(bench.stream(MESSAGE, offer), not_wanted(), "never offered");
    }
    // Nobody sends messages of a service.
    let mut bench = Bench::open();
    bench.offered(1, service());
    bench.input(Input::Want { offer: 1, depth: 1 });
    assert_eq!(bench.stream(MESSAGE, 1), not_wanted());
}

//= SM2-GWO-002 test
#[test]
fn wanted_again_before_its_end_is_confirmed() {
    let want = |depth| Input::Want { offer: 1, depth };
    let unwant = || Input::Unwant { offer: 1 };
    let unwanted = Frame::Unwanted { offer: 1 };
    let mut bench = Bench::open();
    bench.offered(1, topic());
    bench.input(want(2));
    bench.input(unwant());
    assert_eq!(bench.misuse(unwant()), Misuse::WrongOffer);
    assert_eq!(bench.stream(MESSAGE, 1), [Output::Discard { stream: 7 }]);
    assert_eq!(bench.input(want(3)), []);
    assert_eq!(bench.stream(MESSAGE, 1), [Output::Take { stream: 7 }]);
    assert_eq!(bench.misuse(want(3)), Misuse::WrongOffer);
    let mut changed = Bench(bench.0.clone());
    let again = Frame::Want { offer: 1, depth: 3 };
    assert_eq!(bench.frame(&unwanted), [transmit(&again)]);
    assert_eq!(bench.stream(MESSAGE, 1), [Output::Take { stream: 7 }]);
    assert_eq!(changed.input(unwant()), []);
    assert_eq!(changed.frame(&unwanted), []);
    assert_eq!(changed.stream(MESSAGE, 1), [Output::Discard { stream: 7 }]);
}

//= SM2-GWO-001, SM2-GWO-003 test
#[test]
fn offers_that_are_refused() {
    let offer = |offer, path| Frame::Offer {
        offer,
        subject: topic(),
        path,
    };
    let wrong_epoch = Hop { epoch: 1, ..hop(2) };
    for (frame, expected) in [
        (offer(5, vec![hop(2)]), PeerViolation::BadOffer),
        (offer(4, vec![hop(2)]), PeerViolation::BadOffer),
        (offer(6, vec![hop(3)]), PeerViolation::BadPath),
        (offer(6, vec![hop(2), hop(3)]), PeerViolation::BadPath),
        (offer(6, vec![wrong_epoch]), PeerViolation::BadPath),
        (offer(6, vec![hop(1), hop(2)]), PeerViolation::BadPath),
    ] {
        let mut bench = Bench::open();
        bench.offered(5, topic());
        assert_eq!(bench.frame(&frame), ended(expected), "{frame:?}");
    }
    let mut zero = Bench::open();
    let first = offer(0, vec![hop(2)]);
    assert_eq!(zero.frame(&first), ended(PeerViolation::BadOffer));
    let mut many = Bench::open();
    for offer in 1..=OFFERS_MAX as u64 {
        many.offered(offer, topic());
    }
    let mut full = Bench(many.0.clone());
    let one_more = OFFERS_MAX as u64 + 1;
    let frame = offer(one_more, vec![hop(2)]);
    assert_eq!(full.frame(&frame), ended(PeerViolation::OfferLimit));
    many.frame(&Frame::Unoffer { offer: 9 });
    many.offered(one_more, topic());
}

//= SM2-GWS-001, SM2-GWS-002 test
#[test]
fn calls_of_the_peer() {
    let take = [Output::Take { stream: 7 }];
    let unreachable = [Output::Unreachable { stream: 7 }];
    let mut bench = Bench::open();
    bench.offer(1, service());
    bench.offer(2, topic());
    assert_eq!(bench.stream(REQUEST, 1), unreachable, "not wanted yet");
    bench.frame(&Frame::Want { offer: 1, depth: 1 });
    assert_eq!(bench.stream(REQUEST, 1), take);
    for offer in [0, 2, 3] {
        let mut bench = Bench(bench.0.clone());
        let refused = ended(PeerViolation::UnknownOffer);
        assert_eq!(bench.stream(REQUEST, offer), refused, "{offer}");
    }
    bench.input(Input::Unoffer { offer: 1 });
    assert_eq!(bench.stream(REQUEST, 1), unreachable, "withdrawn");
    bench.frame(&Frame::Unoffered { offer: 1 });
    assert_eq!(bench.stream(REQUEST, 1), unreachable, "gone");
}

//= SM2-GWS-002 test
#[test]
fn calls_to_the_peer() {
    let call = |stream, offer| Input::Call { stream, offer };
    let failed = |stream| Output::CallFailed { stream };
    let open = || {
        let mut bench = Bench::open();
        bench.offered(1, service());
        bench.offered(2, topic());
        assert_eq!(bench.misuse(call(7, 1)), Misuse::WrongOffer);
        bench.input(Input::Want { offer: 1, depth: 1 });
        bench.input(Input::Want { offer: 2, depth: 1 });
        assert_eq!(bench.misuse(call(7, 2)), Misuse::WrongOffer);
        assert_eq!(bench.misuse(call(7, 3)), Misuse::WrongOffer);
        for stream in [7, 8] {
            assert_eq!(bench.input(call(stream, 1)), []);
        }
        assert_eq!(bench.misuse(call(7, 1)), Misuse::StreamInUse);
        bench
    };
    let mut bench = open();
    assert_eq!(bench.stream(REPLY, 1), [Output::Take { stream: 7 }]);
    assert_eq!(
        bench.stream(REPLY, 1),
        [
            failed(8),
            Output::Ended(End::Violation(PeerViolation::UnknownCall))
        ]
    );
    // It is no reply to its call: that one fails like the others.
    let end = End::Violation(PeerViolation::UnknownCall);
    let wrong = open().stream(REPLY, 2);
    assert_eq!(wrong, [failed(7), failed(8), Output::Ended(end)]);
    let mut bench = open();
    assert_eq!(bench.input(Input::Forget { stream: 7 }), []);
    assert_eq!(bench.misuse(Input::Forget { stream: 7 }), Misuse::NoCall);
    assert_eq!(
        bench.frame(&Frame::Unoffer { offer: 2 }).len(),
        2,
        "of another offer"
    );
    let outputs = bench.frame(&Frame::Unoffer { offer: 1 });
    assert_eq!(outputs[0], failed(8));
    let outputs = open().input(Input::Unwant { offer: 1 });
    assert_eq!(outputs[..2], [failed(7), failed(8)]);
    let code = Some(Code(3));
    let outputs = open().input(Input::Closed(code));
    assert_eq!(
        outputs,
        [failed(7), failed(8), Output::Ended(End::Closed(code))]
    );
}

//= SM2-GWO-005 test
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
    // The peer numbers them as it likes.
    for number in [4, 1, 4] {
        let asked = Output::Asked {
            ask: number,
            kind,
            name: name("a"),
        };
        assert_eq!(bench.frame(&ask(number)), [asked]);
    }
    let verdict = Verdict::Denied;
    let wrong = Input::Answer { ask: 1, verdict };
    assert_eq!(bench.misuse(wrong), Misuse::NotAsked);
    for number in [4, 1, 4] {
        let outputs = bench.input(Input::Answer {
            ask: number,
            verdict,
        });
        assert_eq!(outputs, [transmit(&answer(number, verdict))]);
    }
    for number in 0..QUESTIONS_MAX as u64 {
        bench.frame(&ask(number));
    }
    assert_eq!(bench.frame(&ask(0)), ended(PeerViolation::Malformed));
    let mut bench = Bench::open();
    for number in 0..QUESTIONS_MAX as u64 {
        let name = name("a");
        let asked = bench.input(Input::Ask {
            ask: number,
            kind,
            name,
        });
        assert_eq!(asked, [transmit(&ask(number))]);
    }
    let one_more = Input::Ask {
        ask: 9,
        kind,
        name: name("a"),
    };
    assert_eq!(bench.misuse(one_more), Misuse::TooManyQuestions);
    let answered = Output::Answered { ask: 0, verdict };
    assert_eq!(bench.frame(&answer(0, verdict)), [answered]);
    let refused = ended(PeerViolation::UnexpectedAnswer);
    assert_eq!(bench.frame(&answer(0, verdict)), refused);
}

#[test]
fn what_a_driver_may_not_do() {
    let offer = |offer, path| Input::Offer {
        offer,
        subject: topic(),
        path,
    };
    let mut early = Bench(session(1, 2));
    early.0.poll();
    let first = offer(1, vec![hop(1)]);
    assert_eq!(early.misuse(first), Misuse::NotOpen);
    let mut bench = Bench::open();
    bench.offer(2, topic());
    bench.offered(1, topic());
    let old = Hop { epoch: 1, ..hop(1) };
    let long = (3..11).map(hop).chain([hop(1)]).collect();
    let table = [
        (offer(2, vec![hop(1)]), Misuse::OfferNumber),
        (offer(3, vec![]), Misuse::WrongPath),
        (offer(3, vec![old]), Misuse::WrongPath),
        (offer(3, vec![hop(2), hop(1)]), Misuse::WrongPath),
        (offer(3, vec![hop(3), hop(3), hop(1)]), Misuse::WrongPath),
        (offer(3, long), Misuse::WrongPath),
        (Input::Unoffer { offer: 1 }, Misuse::WrongOffer),
        (Input::Want { offer: 2, depth: 1 }, Misuse::WrongOffer),
        (Input::Want { offer: 1, depth: 0 }, Misuse::WrongDepth),
        (
            Input::Want {
                offer: 1,
                depth: 1_025,
            },
            Misuse::WrongDepth,
        ),
        (Input::Unwant { offer: 1 }, Misuse::WrongOffer),
    ];
    for (input, expected) in table {
        assert_eq!(bench.misuse(input.clone()), expected, "{input:?}");
    }
    bench.input(Input::Unoffer { offer: 2 });
    assert_eq!(
        bench.misuse(Input::Unoffer { offer: 2 }),
        Misuse::WrongOffer
    );
    bench.input(Input::Want { offer: 1, depth: 1 });
    let again = Input::Want { offer: 1, depth: 1 };
    assert_eq!(bench.misuse(again), Misuse::WrongOffer);
    for offer in 3..=OFFERS_MAX as u64 + 1 {
        bench.offer(offer, topic());
    }
    // The one that is being withdrawn counts as long as the peer may name it.
    let one_more = offer(OFFERS_MAX as u64 + 2, vec![hop(1)]);
    assert_eq!(bench.misuse(one_more), Misuse::TooManyOffers);
}

#[test]
fn both_ways_to_end_it() {
    let code = PeerFarewell::ShuttingDown.code();
    for input in [Input::Close(code), Input::Closed(None)] {
        let mut bench = Bench::open();
        let end = match input {
            Input::Close(code) => End::Local(code),
            _ => End::Closed(None),
        };
        assert_eq!(bench.input(input), [Output::Ended(end)]);
        assert_eq!(bench.0.end(), Some(end));
        assert_eq!(bench.misuse(Input::Control(&[1])), Misuse::Ended);
    }
    // What stands behind the frame that ended it is not read.
    let mut bench = Bench::open();
    let bytes = [hello(2).to_bytes(), hello(2).to_bytes()].concat();
    let outputs = bench.input(Input::Control(&bytes));
    assert_eq!(outputs, ended(PeerViolation::UnexpectedHello));
}
