//! The nearest counterparts of an interface.

use sm2_node::explain::{NEAR_MAX, nearest};
use sm2_proto::{Refusal, control::Item, domain::Domain};

use super::{
    contracts::{client, data, publisher_with, scan, subscriber, subscriber_with},
    items::{LIDAR, LINK, PLANNER, at, domain, interface, refusal, sub},
};

#[test]
fn the_nearest_come_first() {
    let mut domain = domain(&scan(), &subscriber("front/scan", None), &[]);
    let strict = subscriber_with("scan", None, true, false);
    let plain = publisher_with("scan", &data("Scan"), false, false);
    domain.page([
        interface(at(LIDAR, 1), &plain),
        interface(at(LIDAR, 2), &scan()),
        interface(at(PLANNER, 2), &subscriber("Scan", None)),
        interface(at(PLANNER, 3), &strict),
        interface(at(PLANNER, 4), &subscriber("image", None)),
        refusal(at(PLANNER, 5), &sub(), &Refusal::NameTaken),
        interface(at(PLANNER, 6), &sub()),
        interface(at(PLANNER, 7), &client("scan", None)),
    ]);
    let near = |domain: &Domain| {
        let near = nearest(domain, at(LIDAR, 1));
        assert!(
            near.iter()
                .all(|it| it.to_string() == it.verdict.to_string())
        );
        near.iter()
            .map(|it| it.entity.interface.0)
            .collect::<Vec<_>>()
    };
    assert_eq!(near(&domain), [6, 5, 3, 2, 1]);
    // An interface that has a link is not named.
    domain.page([Item::Link {
        link: LINK,
        offering: at(LIDAR, 1),
        demanding: at(PLANNER, 6),
        version: 1,
        reliable: false,
        sealed: false,
    }]);
    assert_eq!(near(&domain), [5, 3, 2, 1]);
    domain.page((10..99).map(|number| interface(at(PLANNER, number), &strict)));
    domain.page([interface(at(PLANNER, 99), &sub())]);
    assert_eq!(near(&domain).len(), NEAR_MAX);
    assert_eq!(near(&domain)[..3], [99, 5, 3], "the best of all");
}
