//! The ends of connections with many offers, updated in pieces.

use sm2_proto::{
    Machine,
    gateway::{
        GatewayId, OfferId,
        router::{Input, Output, PIECE_DECISIONS},
    },
    limits::OFFERS_MAX,
};

use super::{
    Bench, id, open,
    pieces::{PEERS, count, crowd, ticks},
};

//= SM2-GWO-008 test
#[test]
fn the_end_of_a_connection_is_handled_in_bounded_pieces() {
    for is_one in [false, true] {
        let (mut bench, own_offers) = crowd(is_one);
        let lost = own_offers.iter().filter(|(peer, _)| *peer == id(1)).count();
        let mut pieces = vec![bench.input(Input::Down { peer: id(1) })];
        assert!(bench.0.deadline().is_some());
        pieces.extend(ticks(&mut bench));
        // Each of its routes costs at most 1 + 1 + 3 + 3 decisions and makes at most 3 + 1 outputs.
        let longest = pieces.iter().map(Vec::len).max();
        assert!(longest <= Some(PIECE_DECISIONS), "{longest:?}");
        // A piece ends at least one offer for each `1 + 4 + 4 + 3` decisions.
        let most = (OFFERS_MAX + lost) * 12 / PIECE_DECISIONS + 2;
        assert!(pieces.len() <= most, "{} pieces", pieces.len());
        let unoffers = count(&pieces, |it| matches!(it, Output::Unoffer { .. }));
        assert_eq!(unoffers, OFFERS_MAX * (PEERS - 1));
        let hidden = count(&pieces, |it| matches!(it, Output::WithdrawProxy { .. }));
        assert_eq!(hidden, OFFERS_MAX);
        assert_eq!(bench.0.deadline(), None);
    }
}

/// A source whose offers were all made by one connection ends once, and not once for each of them.
//= SM2-GWO-008 test
#[test]
fn many_offers_of_one_source_end_together() {
    let mut bench = Bench::new(open(), &[1, 2]);
    for number in 1..=OFFERS_MAX {
        bench.offered(OfferId(number as u64), &[5, 1]);
    }
    let mut pieces = vec![bench.input(Input::Down { peer: id(1) })];
    pieces.extend(ticks(&mut bench));
    assert!(
        pieces.len() <= OFFERS_MAX / PIECE_DECISIONS + 1,
        "{}",
        pieces.len()
    );
    let outputs: Vec<Output> = pieces.into_iter().flatten().collect();
    assert!(
        matches!(
            outputs[..],
            [Output::Unoffer { .. }, Output::WithdrawProxy { .. }]
        ),
        "{outputs:?}"
    );
}

/// Nothing follows from the offers of a connection that has ended, although they are not removed yet.
//= SM2-GWO-008 test
#[test]
fn a_connection_that_has_ended_takes_and_gives_nothing_before_its_piece() {
    let (mut bench, own_offers) = crowd(false);
    let last = own_offers.iter().rfind(|(peer, _)| *peer == id(1));
    let &(peer, offer) = last.unwrap();
    bench.input(Input::Wanted {
        peer,
        offer,
        depth: 1,
    });
    let of = bench.0.source(peer, offer);
    let (subject, source) = of
        .map(|(subject, source)| (subject.clone(), source))
        .unwrap();
    let takers = |bench: &Bench| -> Vec<GatewayId> {
        bench
            .0
            .takers(&subject, source)
            .map(|(peer, _)| peer)
            .collect()
    };
    assert_eq!(takers(&bench), [peer]);
    bench.input(Input::Down { peer });
    assert!(bench.0.deadline().is_some());
    assert_eq!(takers(&bench), []);
    assert_eq!(bench.0.source(peer, offer), None);
    // It comes back at once, and is offered the source anew.
    bench.input(Input::Up { peer });
    assert_eq!(bench.0.source(peer, offer), None);
    let outputs = bench.input(Input::Use {
        subject: subject.clone(),
        source,
    });
    let offered = |it: &Output| matches!(it, Output::Offer { peer: to, .. } if *to == peer);
    assert!(outputs.iter().any(offered), "{outputs:?}");
    assert_eq!(takers(&bench), []);
    ticks(&mut bench);
    assert_eq!(takers(&bench), []);
}
