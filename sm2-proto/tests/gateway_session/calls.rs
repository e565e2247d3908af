//! Calls in both directions, and how they fail.

use sm2_proto::{
    Code,
    gateway::{
        Carried, Frame, Outcome, PeerViolation,
        session::{End, Input, Misuse, Output},
    },
};

use super::{Bench, REQUEST, ended, service, topic};

const REPLY: Carried = Carried::Reply {
    status: Outcome::Ok,
};

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
