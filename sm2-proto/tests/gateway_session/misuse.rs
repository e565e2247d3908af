//! Inputs that a driver may not give: misuse, which changes nothing.

use sm2_proto::{
    gateway::{
        Hop, OfferId,
        session::{Command, Input, Misuse},
    },
    limits::OFFERS_MAX,
};

use super::{Bench, ONE, hop, session, topic};

#[test]
fn what_a_driver_may_not_do() {
    let offer = |offer, path| {
        Input::Command(Command::Offer {
            offer,
            subject: topic(),
            path,
        })
    };
    let mut early = Bench::greeting(session(1, 2));
    let first = offer(ONE, vec![hop(1)]);
    assert_eq!(early.misuse(first), Misuse::NotOpen);
    let mut bench = Bench::open();
    bench.offer(OfferId(2), topic());
    bench.offered(ONE, topic());
    let old = Hop { epoch: 1, ..hop(1) };
    let long = (3..11).map(hop).chain([hop(1)]).collect();
    let table = [
        (offer(OfferId(2), vec![hop(1)]), Misuse::OfferNumber),
        (offer(OfferId(3), vec![]), Misuse::WrongPath),
        (offer(OfferId(3), vec![old]), Misuse::WrongPath),
        (offer(OfferId(3), vec![hop(2), hop(1)]), Misuse::WrongPath),
        (
            offer(OfferId(3), vec![hop(3), hop(3), hop(1)]),
            Misuse::WrongPath,
        ),
        (offer(OfferId(3), long), Misuse::WrongPath),
        (
            Input::Command(Command::Unoffer { offer: ONE }),
            Misuse::WrongOffer,
        ),
        (
            Input::Command(Command::Want {
                offer: OfferId(2),
                depth: 1,
            }),
            Misuse::WrongOffer,
        ),
        (
            Input::Command(Command::Want {
                offer: ONE,
                depth: 0,
            }),
            Misuse::WrongDepth,
        ),
        (
            Input::Command(Command::Want {
                offer: ONE,
                depth: 1_025,
            }),
            Misuse::WrongDepth,
        ),
        (
            Input::Command(Command::Unwant { offer: ONE }),
            Misuse::WrongOffer,
        ),
    ];
    for (input, expected) in table {
        assert_eq!(bench.misuse(input.clone()), expected, "{input:?}");
    }
    bench.input(Input::Command(Command::Unoffer { offer: OfferId(2) }));
    assert_eq!(
        bench.misuse(Input::Command(Command::Unoffer { offer: OfferId(2) })),
        Misuse::WrongOffer
    );
    bench.input(Input::Command(Command::Want {
        offer: ONE,
        depth: 1,
    }));
    let again = Input::Command(Command::Want {
        offer: ONE,
        depth: 1,
    });
    assert_eq!(bench.misuse(again), Misuse::WrongOffer);
    for offer in 3..=OFFERS_MAX as u64 + 1 {
        bench.offer(OfferId(offer), topic());
    }
    // The one that is being withdrawn counts as long as the peer may name it.
    let one_more = offer(OfferId(OFFERS_MAX as u64 + 2), vec![hop(1)]);
    assert_eq!(bench.misuse(one_more), Misuse::TooManyOffers);
}
