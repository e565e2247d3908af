//! The matching of interfaces that offer and demand a time, such as a deadline.

use std::time::Duration;

use sm2_node::domain::{Finding, Period};
use sm2_node::{Node, Publisher, Subscriber};

use super::fixture::Fixture;
use super::until;

/// Checks that a subscriber that demands a time is linked with the publishers that offer at most this time, and that
/// `why` tells the `mismatch` of the offered and the demanded time of the others.
pub(crate) fn only_short_offers_match(
    fixture: &Fixture,
    publisher: fn(&Node, Duration) -> Publisher<u64>,
    subscriber: fn(&Node, Duration) -> Subscriber<u64>,
    mismatch: fn(Period, Period) -> Finding,
) {
    let (talker, listener) = (fixture.peer("talker"), fixture.node("listener"));
    let second = Duration::from_secs(1);
    let _offered = publisher(&talker, second);
    let _none = talker.publisher::<u64>("topic").unwrap();
    let demanding = subscriber(&listener, second - Duration::from_nanos(1));
    let content = subscriber(&listener, second);
    let careless = listener.subscriber::<u64>("topic").unwrap();
    let linked = |it: &Subscriber<u64>| it.links().iter().filter(|it| it.open).count();
    until(|| (linked(&content), linked(&careless)) == (1, 2));
    assert_eq!(demanding.links().len(), 0);
    // The nearest matches: both publishers.
    let verdicts: Vec<_> = demanding.why().unwrap();
    let demanded = Period(999_999_999);
    for offered in [Period(1_000_000_000), Period::NONE] {
        let expected = mismatch(offered, demanded);
        let mut findings = verdicts.iter().map(|near| &near.verdict.finding);
        assert!(findings.any(|it| *it == expected), "{verdicts:?}");
    }
}
