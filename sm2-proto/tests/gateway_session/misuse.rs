//! Misuse by the driver changes nothing.

use sm2_proto::{
    gateway::{
        Hop, OfferId,
        session::{Command, ControlCommand, Input, Misuse},
    },
    limits::OFFERS_MAX,
};

use super::{Bench, ONE, hop, session, topic};

fn offer(offer: OfferId, path: Vec<Hop>) -> Input<'static> {
    Input::Command(Command::Offer {
        offer,
        subject: topic(),
        path,
    })
}

/// Commands that are a misuse where offer 2 of this side and offer 1 of the peer exist.
fn misuses() -> Vec<(Command, Misuse)> {
    let offered = |path| Command::Offer {
        offer: OfferId(3),
        subject: topic(),
        path,
    };
    let used = Command::Offer {
        offer: OfferId(2),
        subject: topic(),
        path: vec![hop(1)],
    };
    let want = |offer, depth| Command::Control(ControlCommand::Want { offer, depth });
    let old = Hop { epoch: 1, ..hop(1) };
    let long = (3..11).map(hop).chain([hop(1)]).collect();
    let through_the_peer = vec![hop(2), hop(1)];
    let twice = vec![hop(3), hop(3), hop(1)];
    vec![
        (used, Misuse::OfferNumber),
        (offered(vec![]), Misuse::WrongPath),
        (offered(vec![old]), Misuse::WrongPath),
        (offered(through_the_peer), Misuse::WrongPath),
        (offered(twice), Misuse::WrongPath),
        (offered(long), Misuse::WrongPath),
        (
            Command::Control(ControlCommand::Unoffer { offer: ONE }),
            Misuse::WrongOffer,
        ),
        (want(OfferId(2), 1), Misuse::WrongOffer),
        (want(ONE, 0), Misuse::WrongDepth),
        (want(ONE, 1_025), Misuse::WrongDepth),
        (
            Command::Control(ControlCommand::Unwant { offer: ONE }),
            Misuse::WrongOffer,
        ),
    ]
}

#[test]
fn what_a_driver_may_not_do() {
    let mut early = Bench::greeting(session(1, 2));
    let first = offer(ONE, vec![hop(1)]);
    assert_eq!(early.misuse(first), Misuse::NotOpen);
    let mut bench = Bench::open();
    bench.offer(OfferId(2), topic());
    bench.offered(ONE, topic());
    for (command, expected) in misuses() {
        let input = Input::Command(command.clone());
        assert_eq!(bench.misuse(input), expected, "{command:?}");
    }
    let unoffer = || {
        Input::Command(Command::Control(ControlCommand::Unoffer {
            offer: OfferId(2),
        }))
    };
    bench.input(unoffer());
    assert_eq!(bench.misuse(unoffer()), Misuse::WrongOffer);
    let want = || {
        Input::Command(Command::Control(ControlCommand::Want {
            offer: ONE,
            depth: 1,
        }))
    };
    bench.input(want());
    assert_eq!(bench.misuse(want()), Misuse::WrongOffer);
    for offer in 3..=OFFERS_MAX as u64 + 1 {
        bench.offer(OfferId(offer), topic());
    }
    // An offer that is being withdrawn counts as long as the peer may name it.
    let one_more = offer(OfferId(OFFERS_MAX as u64 + 2), vec![hop(1)]);
    assert_eq!(bench.misuse(one_more), Misuse::TooManyOffers);
}
