//! Calls in both directions, and how they fail.

use sm2_proto::{
    Code,
    gateway::{
        Frame, Header, HeaderKind, OfferId, Outcome, PeerViolationKind, StreamToken,
        session::{Command, ControlCommand, End, Input, Misuse, Output, PeerEvent, Transport},
    },
    violation,
};

use super::{Bench, MESSAGE, ONE, REQUEST, SEVEN, ended, service, topic};

const REPLY: HeaderKind = HeaderKind::Reply {
    status: Outcome::Ok,
};

//= SM2-GWS-001, SM2-GWS-002 test
#[test]
fn calls_of_the_peer() {
    let take = [Output::Take {
        transport: Transport::Stream(SEVEN),
    }];
    let unreachable = [Output::Unreachable { stream: SEVEN }];
    let mut bench = Bench::open();
    bench.offer(ONE, service());
    bench.offer(OfferId(2), topic());
    assert_eq!(bench.stream(REQUEST, ONE), unreachable, "not wanted yet");
    bench.frame(&Frame::Want {
        offer: ONE,
        depth: 1,
    });
    assert_eq!(bench.stream(REQUEST, ONE), take);
    for offer in [0, 2, 3] {
        let mut bench = Bench(bench.0.clone());
        let refused = ended(violation!(PeerViolationKind::UnknownOffer, "SM2-GWS-001"));
        assert_eq!(bench.stream(REQUEST, OfferId(offer)), refused, "{offer}");
    }
    bench.input(Input::Command(Command::Control(ControlCommand::Unoffer {
        offer: ONE,
    })));
    assert_eq!(bench.stream(REQUEST, ONE), unreachable, "withdrawn");
    bench.frame(&Frame::Unoffered { offer: ONE });
    assert_eq!(bench.stream(REQUEST, ONE), unreachable, "gone");
}

const EIGHT: StreamToken = StreamToken(8);

fn call(stream: StreamToken, offer: OfferId) -> Input<'static> {
    Input::Command(Command::Call { stream, offer })
}

fn failed(stream: StreamToken) -> Output {
    Output::CallFailed { stream }
}

/// A session with two calls of the peer's service, offer 1; offer 2 is a topic.
fn with_two_calls() -> Bench {
    let want = |offer| Input::Command(Command::Control(ControlCommand::Want { offer, depth: 1 }));
    let mut bench = Bench::open();
    bench.offered(ONE, service());
    bench.offered(OfferId(2), topic());
    assert_eq!(bench.misuse(call(SEVEN, ONE)), Misuse::WrongOffer);
    bench.input(want(ONE));
    bench.input(want(OfferId(2)));
    for not_a_service in [2, 3] {
        let call = call(SEVEN, OfferId(not_a_service));
        assert_eq!(bench.misuse(call), Misuse::WrongOffer);
    }
    for stream in [SEVEN, EIGHT] {
        assert_eq!(bench.input(call(stream, ONE)), []);
    }
    assert_eq!(bench.misuse(call(SEVEN, ONE)), Misuse::StreamInUse);
    bench
}

//= SM2-GWS-002 test
#[test]
fn calls_to_the_peer() {
    let unknown = || {
        let violation = violation!(PeerViolationKind::UnknownCall, "SM2-GWS-002");
        Output::Ended(End::Violation(violation))
    };
    let transport = Transport::Stream(SEVEN);
    let mut bench = with_two_calls();
    assert_eq!(bench.stream(REPLY, ONE), [Output::Take { transport }]);
    let second_reply = bench.stream(REPLY, ONE);
    assert_eq!(second_reply, [failed(EIGHT), unknown()]);
    // A reply for another offer answers no call: both calls fail.
    let wrong = with_two_calls().stream(REPLY, OfferId(2));
    assert_eq!(wrong, [failed(SEVEN), failed(EIGHT), unknown()]);
    let mut bench = with_two_calls();
    let forget = || Input::Command(Command::Forget { stream: SEVEN });
    assert_eq!(bench.input(forget()), []);
    assert_eq!(bench.misuse(forget()), Misuse::NoCall);
    let outputs = bench.frame(&Frame::Unoffer { offer: OfferId(2) });
    assert_eq!(outputs.len(), 2, "of another offer");
    let outputs = bench.frame(&Frame::Unoffer { offer: ONE });
    assert_eq!(outputs[0], failed(EIGHT));
    let outputs =
        with_two_calls().input(Input::Command(Command::Control(ControlCommand::Unwant {
            offer: ONE,
        })));
    assert_eq!(outputs[..2], [failed(SEVEN), failed(EIGHT)]);
    let code = Some(Code(3));
    let outputs = with_two_calls().input(Input::Event(PeerEvent::Closed(code)));
    let end = Output::Ended(End::Closed(code));
    assert_eq!(outputs, [failed(SEVEN), failed(EIGHT), end]);
}

/// Requests and replies in datagrams are violations.
//= SM2-GWM-003 test
#[test]
fn datagrams_carry_messages_alone() {
    let malformed = || {
        let violation = violation!(PeerViolationKind::Malformed, "SM2-GWM-003");
        vec![Output::Ended(End::Violation(violation))]
    };
    let transport = Transport::Datagram;
    let table = [
        (MESSAGE, vec![Output::Take { transport }]),
        (REQUEST, malformed()),
        (REPLY, malformed()),
    ];
    for (kind, expected) in table {
        let mut bench = Bench::open();
        bench.offer(ONE, service());
        bench.offered(ONE, topic());
        bench.frame(&Frame::Want {
            offer: ONE,
            depth: 1,
        });
        bench.input(Input::Command(Command::Control(ControlCommand::Want {
            offer: ONE,
            depth: 1,
        })));
        let header = Header {
            kind,
            offer: ONE,
            len: 0,
        };
        let event = PeerEvent::Header { transport, header };
        assert_eq!(bench.input(Input::Event(event)), expected, "{kind:?}");
    }
}
