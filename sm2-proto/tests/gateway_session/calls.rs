//! Calls in both directions, and how they fail.

use sm2_proto::{
    Code,
    gateway::{
        Carried, Frame, Header, OfferId, Outcome, PeerViolationKind, StreamToken,
        session::{Carrier, Command, End, Input, Misuse, Output, PeerEvent},
    },
    violation,
};

use super::{Bench, MESSAGE, ONE, REQUEST, SEVEN, ended, service, topic};

const REPLY: Carried = Carried::Reply {
    status: Outcome::Ok,
};

//= SM2-GWS-001, SM2-GWS-002 test
#[test]
fn calls_of_the_peer() {
    let take = [Output::Take {
        carrier: Carrier::Stream(SEVEN),
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
    bench.input(Input::Command(Command::Unoffer { offer: ONE }));
    assert_eq!(bench.stream(REQUEST, ONE), unreachable, "withdrawn");
    bench.frame(&Frame::Unoffered { offer: ONE });
    assert_eq!(bench.stream(REQUEST, ONE), unreachable, "gone");
}

//= SM2-GWS-002 test
#[test]
fn calls_to_the_peer() {
    let call = |stream, offer| Input::Command(Command::Call { stream, offer });
    let failed = |stream| Output::CallFailed { stream };
    let open = || {
        let mut bench = Bench::open();
        bench.offered(ONE, service());
        bench.offered(OfferId(2), topic());
        assert_eq!(
            bench.misuse(call(StreamToken(7), OfferId(1))),
            Misuse::WrongOffer
        );
        bench.input(Input::Command(Command::Want {
            offer: ONE,
            depth: 1,
        }));
        bench.input(Input::Command(Command::Want {
            offer: OfferId(2),
            depth: 1,
        }));
        assert_eq!(
            bench.misuse(call(StreamToken(7), OfferId(2))),
            Misuse::WrongOffer
        );
        assert_eq!(
            bench.misuse(call(StreamToken(7), OfferId(3))),
            Misuse::WrongOffer
        );
        for stream in [7, 8] {
            assert_eq!(bench.input(call(StreamToken(stream), OfferId(1))), []);
        }
        assert_eq!(
            bench.misuse(call(StreamToken(7), OfferId(1))),
            Misuse::StreamInUse
        );
        bench
    };
    let mut bench = open();
    assert_eq!(
        bench.stream(REPLY, ONE),
        [Output::Take {
            carrier: Carrier::Stream(SEVEN)
        }]
    );
    assert_eq!(
        bench.stream(REPLY, ONE),
        [
            failed(StreamToken(8)),
            Output::Ended(End::Violation(violation!(
                PeerViolationKind::UnknownCall,
                "SM2-GWS-002"
            )))
        ]
    );
    // It is no reply to its call: that one fails like the others.
    let end = End::Violation(violation!(PeerViolationKind::UnknownCall, "SM2-GWS-002"));
    let wrong = open().stream(REPLY, OfferId(2));
    assert_eq!(
        wrong,
        [
            failed(StreamToken(7)),
            failed(StreamToken(8)),
            Output::Ended(end)
        ]
    );
    let mut bench = open();
    assert_eq!(
        bench.input(Input::Command(Command::Forget { stream: SEVEN })),
        []
    );
    assert_eq!(
        bench.misuse(Input::Command(Command::Forget { stream: SEVEN })),
        Misuse::NoCall
    );
    assert_eq!(
        bench.frame(&Frame::Unoffer { offer: OfferId(2) }).len(),
        2,
        "of another offer"
    );
    let outputs = bench.frame(&Frame::Unoffer { offer: ONE });
    assert_eq!(outputs[0], failed(StreamToken(8)));
    let outputs = open().input(Input::Command(Command::Unwant { offer: ONE }));
    assert_eq!(
        outputs[..2],
        [failed(StreamToken(7)), failed(StreamToken(8))]
    );
    let code = Some(Code(3));
    let outputs = open().input(Input::Event(PeerEvent::Closed(code)));
    assert_eq!(
        outputs,
        [
            failed(StreamToken(7)),
            failed(StreamToken(8)),
            Output::Ended(End::Closed(code))
        ]
    );
}

/// A datagram carries a message and nothing else.
//= SM2-GWM-003 test
#[test]
fn datagrams_carry_messages_alone() {
    let malformed = || {
        let violation = violation!(PeerViolationKind::Malformed, "SM2-GWM-003");
        vec![Output::Ended(End::Violation(violation))]
    };
    let carrier = Carrier::Datagram;
    let table = [
        (MESSAGE, vec![Output::Take { carrier }]),
        (REQUEST, malformed()),
        (REPLY, malformed()),
    ];
    for (carried, expected) in table {
        let mut bench = Bench::open();
        bench.offer(ONE, service());
        bench.offered(ONE, topic());
        bench.frame(&Frame::Want {
            offer: ONE,
            depth: 1,
        });
        bench.input(Input::Command(Command::Want {
            offer: ONE,
            depth: 1,
        }));
        let header = Header {
            carried,
            offer: ONE,
            len: 0,
        };
        let event = PeerEvent::Header { carrier, header };
        assert_eq!(bench.input(Input::Event(event)), expected, "{carried:?}");
    }
}
