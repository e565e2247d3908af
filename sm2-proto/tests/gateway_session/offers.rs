//! Offers of both sides in each state.

use sm2_proto::{
    gateway::{
        Frame, Hop, OfferId, PeerViolationKind,
        session::{Command, ControlCommand, Event, Input, Misuse, Output, Transport},
    },
    limits::OFFERS_MAX,
    violation,
};

use super::{Bench, MESSAGE, ONE, SEVEN, ended, hop, service, topic, transmit};

//= SM2-GWO-002 test
#[test]
fn what_the_peer_says_of_our_offers() {
    let want = Frame::Want {
        offer: ONE,
        depth: 3,
    };
    let unwant = Frame::Unwant { offer: ONE };
    let unoffered = Frame::Unoffered { offer: ONE };
    let unknown = || ended(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"));
    let wanted = || {
        vec![Output::Event(Event::Wanted {
            offer: ONE,
            depth: 3,
        })]
    };
    let unwanted = || {
        let answer = Frame::Unwanted { offer: ONE };
        vec![
            transmit(&answer),
            Output::Event(Event::Unwanted { offer: ONE }),
        ]
    };
    let none = || unknown();
    let table: [(&str, [Vec<Output>; 3]); 4] = [
        ("offered", [wanted(), unknown(), unknown()]),
        (
            "wanted",
            [
                ended(violation!(PeerViolationKind::BadWant, "SM2-GWO-002")),
                unwanted(),
                unknown(),
            ],
        ),
        ("withdrawing", [vec![], vec![], vec![]]),
        ("gone", [none(), none(), none()]),
    ];
    for (state, row) in table {
        for (frame, expected) in [&want, &unwant, &unoffered].into_iter().zip(row) {
            let mut bench = Bench::open();
            bench.offer(ONE, topic());
            if state == "wanted" {
                bench.frame(&want);
            }
            if ["withdrawing", "gone"].contains(&state) {
                let outputs = bench.input(control(ControlCommand::Unoffer { offer: ONE }));
                assert_eq!(outputs, [transmit(&Frame::Unoffer { offer: ONE })]);
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

const fn control(command: ControlCommand) -> Input<'static> {
    Input::Command(Command::Control(command))
}

/// The table of the side that gets an offer (SPEC section 14.3), and messages of the offer.
//= SM2-GWO-002, SM2-GWM-001 test
#[test]
fn what_the_peer_says_of_its_offers() {
    let unoffer = Frame::Unoffer { offer: ONE };
    let unwanted = Frame::Unwanted { offer: ONE };
    let unknown = || ended(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"));
    let not_wanted = || ended(violation!(PeerViolationKind::NotWanted, "SM2-GWM-001"));
    let gone = || {
        let answer = Frame::Unoffered { offer: ONE };
        vec![transmit(&answer), Output::Event(Event::Gone { offer: ONE })]
    };
    let transport = Transport::Stream(SEVEN);
    let take = || vec![Output::Take { transport }];
    let discard = || vec![Output::Discard { transport }];
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
            bench.offered(ONE, topic());
            if ["wanting", "unwanting", "known again"].contains(&state) {
                let frame = Frame::Want {
                    offer: ONE,
                    depth: 2,
                };
                let outputs = bench.input(control(ControlCommand::Want {
                    offer: ONE,
                    depth: 2,
                }));
                assert_eq!(outputs, [transmit(&frame)]);
            }
            if ["unwanting", "known again"].contains(&state) {
                let outputs = bench.input(control(ControlCommand::Unwant { offer: ONE }));
                assert_eq!(outputs, [transmit(&Frame::Unwant { offer: ONE })]);
            }
            match state {
                "known again" => assert_eq!(bench.frame(&unwanted), []),
                "gone" => assert_eq!(bench.frame(&unoffer), gone()),
                _ => {}
            }
            let outputs = match index {
                0 => bench.frame(&unoffer),
                1 => bench.frame(&unwanted),
                _ => bench.stream(MESSAGE, ONE),
            };
            assert_eq!(outputs, expected, "{state}: {index}");
        }
    }
}

//= SM2-GWM-001 test
#[test]
fn messages_that_were_not_wanted() {
    let not_wanted = || ended(violation!(PeerViolationKind::NotWanted, "SM2-GWM-001"));
    for offer in [0, 2] {
        let mut bench = Bench::open();
        bench.offered(ONE, topic());
        assert_eq!(
            bench.stream(MESSAGE, OfferId(offer)),
            not_wanted(),
            "never offered"
        );
    }
    // A message of a service is a violation.
    let mut bench = Bench::open();
    bench.offered(ONE, service());
    bench.input(control(ControlCommand::Want {
        offer: ONE,
        depth: 1,
    }));
    assert_eq!(bench.stream(MESSAGE, ONE), not_wanted());
}

//= SM2-GWO-002 test
#[test]
fn wanted_again_before_its_end_is_confirmed() {
    let want = |depth| control(ControlCommand::Want { offer: ONE, depth });
    let unwant = || control(ControlCommand::Unwant { offer: ONE });
    let unwanted = Frame::Unwanted { offer: ONE };
    let mut bench = Bench::open();
    bench.offered(ONE, topic());
    bench.input(want(2));
    bench.input(unwant());
    assert_eq!(bench.misuse(unwant()), Misuse::WrongOffer);
    assert_eq!(
        bench.stream(MESSAGE, ONE),
        [Output::Discard {
            transport: Transport::Stream(SEVEN)
        }]
    );
    assert_eq!(bench.input(want(3)), []);
    assert_eq!(
        bench.stream(MESSAGE, ONE),
        [Output::Take {
            transport: Transport::Stream(SEVEN)
        }]
    );
    assert_eq!(bench.misuse(want(3)), Misuse::WrongOffer);
    let mut changed = Bench(bench.0.clone());
    let again = Frame::Want {
        offer: ONE,
        depth: 3,
    };
    assert_eq!(bench.frame(&unwanted), [transmit(&again)]);
    assert_eq!(
        bench.stream(MESSAGE, ONE),
        [Output::Take {
            transport: Transport::Stream(SEVEN)
        }]
    );
    assert_eq!(changed.input(unwant()), []);
    assert_eq!(changed.frame(&unwanted), []);
    assert_eq!(
        changed.stream(MESSAGE, ONE),
        [Output::Discard {
            transport: Transport::Stream(SEVEN)
        }]
    );
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
        (
            offer(OfferId(5), vec![hop(2)]),
            violation!(PeerViolationKind::BadOffer, "SM2-GWO-001"),
        ),
        (
            offer(OfferId(4), vec![hop(2)]),
            violation!(PeerViolationKind::BadOffer, "SM2-GWO-001"),
        ),
        (
            offer(OfferId(6), vec![hop(3)]),
            violation!(PeerViolationKind::BadPath, "SM2-GWO-003"),
        ),
        (
            offer(OfferId(6), vec![hop(2), hop(3)]),
            violation!(PeerViolationKind::BadPath, "SM2-GWO-003"),
        ),
        (
            offer(OfferId(6), vec![wrong_epoch]),
            violation!(PeerViolationKind::BadPath, "SM2-GWO-003"),
        ),
        (
            offer(OfferId(6), vec![hop(1), hop(2)]),
            violation!(PeerViolationKind::BadPath, "SM2-GWO-003"),
        ),
    ] {
        let mut bench = Bench::open();
        bench.offered(OfferId(5), topic());
        assert_eq!(bench.frame(&frame), ended(expected), "{frame:?}");
    }
    let mut zero = Bench::open();
    let first = offer(OfferId(0), vec![hop(2)]);
    assert_eq!(
        zero.frame(&first),
        ended(violation!(PeerViolationKind::BadOffer, "SM2-GWO-001"))
    );
    let mut many = Bench::open();
    for offer in 1..=OFFERS_MAX as u64 {
        many.offered(OfferId(offer), topic());
    }
    let mut full = Bench(many.0.clone());
    let one_more = OFFERS_MAX as u64 + 1;
    let frame = offer(OfferId(one_more), vec![hop(2)]);
    assert_eq!(
        full.frame(&frame),
        ended(violation!(PeerViolationKind::OfferLimit, "SM2-GWO-001"))
    );
    many.frame(&Frame::Unoffer { offer: OfferId(9) });
    many.offered(OfferId(one_more), topic());
}
