//! The spool: fates, limits, and a random comparison with the plainest spool that could be written.

use std::time::Duration;

use proptest::collection::vec;
use proptest::prelude::*;
use sm2_bridge_core::{Fate, Id, Limits, Output, REORDER_MAX, Spool, SpoolCounts};
use sm2_proto::Instant;

const SECOND: Duration = Duration::from_secs(1);

/// A time in seconds.
fn at(seconds: u64) -> Instant {
    Instant(seconds * 1_000_000_000)
}

fn limits(max_bytes: u64, window_bytes: u64) -> Limits {
    Limits::new(max_bytes, window_bytes).unwrap()
}

/// All tasks of this moment.
fn drain(spool: &mut Spool, now: Instant) -> Vec<Output> {
    std::iter::from_fn(|| spool.poll(now)).collect()
}

#[test]
fn a_message_is_handed_over_when_it_is_acknowledged() {
    let mut spool = Spool::new(limits(100, 10));
    let id = spool.offer(10, at(0));
    assert_eq!(drain(&mut spool, at(0)), [], "the network is away");
    spool.connect();
    assert_eq!(drain(&mut spool, at(1)), [Output::Send(id)]);
    spool.acknowledge(id);
    spool.acknowledge(id);
    spool.reject(id);
    assert_eq!(
        drain(&mut spool, at(2)),
        [Output::End(id, Fate::HandedOver)]
    );
    assert_eq!(spool.deadline(), None);
    let counts = SpoolCounts {
        offered: 1,
        handed_over: 1,
        ..SpoolCounts::default()
    };
    assert_eq!(spool.counts(), counts);
}

#[test]
fn messages_in_flight_are_sent_again_after_an_outage_in_their_order() {
    let mut spool = Spool::new(limits(100, 20));
    let ids: Vec<_> = (0..3).map(|_| spool.offer(10, at(0))).collect();
    spool.connect();
    let sent = [Output::Send(ids[0]), Output::Send(ids[1])];
    assert_eq!(drain(&mut spool, at(0)), sent, "the window has two");
    spool.disconnect(at(1));
    assert_eq!(drain(&mut spool, at(1)), []);
    // The acknowledgement of an attempt before the outage.
    spool.acknowledge(ids[1]);
    spool.connect();
    let again = [
        Output::End(ids[1], Fate::HandedOver),
        Output::Send(ids[0]),
        Output::Send(ids[2]),
    ];
    assert_eq!(drain(&mut spool, at(2)), again);
}

#[test]
fn without_an_acknowledgement_all_in_flight_is_sent_again() {
    let mut spool = Spool::new(limits(100, 20).with_retry(20 * SECOND));
    let (first, second) = (spool.offer(10, at(0)), spool.offer(10, at(0)));
    spool.connect();
    let sent = [Output::Send(first), Output::Send(second)];
    assert_eq!(drain(&mut spool, at(0)), sent);
    assert_eq!(spool.deadline(), Some(at(20)));
    assert_eq!(drain(&mut spool, at(19)), []);
    assert_eq!(drain(&mut spool, at(20)), sent);
    spool.acknowledge(first);
    assert_eq!(
        drain(&mut spool, at(39)),
        [Output::End(first, Fate::HandedOver)]
    );
    assert_eq!(drain(&mut spool, at(40)), [Output::Send(second)]);
}

#[test]
fn the_oldest_messages_expire_when_there_is_no_room() {
    let mut spool = Spool::new(limits(30, 10));
    let ids: Vec<_> = (0..4).map(|_| spool.offer(10, at(0))).collect();
    assert_eq!(
        drain(&mut spool, at(0)),
        [Output::End(ids[0], Fate::Expired)]
    );
    assert_eq!(spool.spooled_bytes(), 30);
    // A message in flight needs room again when the network goes away.
    spool.connect();
    assert_eq!(drain(&mut spool, at(0)), [Output::Send(ids[1])]);
    let last = spool.offer(10, at(0));
    spool.disconnect(at(0));
    assert_eq!(
        drain(&mut spool, at(0)),
        [Output::End(ids[1], Fate::Expired)]
    );
    spool.connect();
    assert_eq!(drain(&mut spool, at(0)), [Output::Send(ids[2])]);
    assert!(last > ids[3]);
}

#[test]
fn a_message_expires_at_its_age_and_one_of_an_earlier_run_sooner() {
    let mut spool = Spool::new(limits(100, 10).with_max_age(60 * SECOND));
    let old = spool.restore(10, 50 * SECOND, at(5));
    let new = spool.offer(10, at(5));
    assert_eq!(spool.deadline(), Some(at(15)));
    assert_eq!(drain(&mut spool, at(14)), []);
    assert_eq!(drain(&mut spool, at(15)), [Output::End(old, Fate::Expired)]);
    assert_eq!(spool.deadline(), Some(at(65)));
    assert_eq!(drain(&mut spool, at(65)), [Output::End(new, Fate::Expired)]);
}

#[test]
fn a_message_that_is_longer_than_the_window_is_refused() {
    let mut spool = Spool::new(limits(100, 10));
    let long = spool.offer(11, at(0));
    let whole = spool.offer(10, at(0));
    assert_eq!(drain(&mut spool, at(0)), [Output::End(long, Fate::Refused)]);
    spool.connect();
    assert_eq!(drain(&mut spool, at(0)), [Output::Send(whole)]);
}

#[test]
fn no_more_messages_are_in_flight_than_duplicates_remembers() {
    let mut spool = Spool::new(limits(10_000, 10_000));
    for _ in 0..2 * REORDER_MAX {
        spool.offer(1, at(0));
    }
    spool.connect();
    assert_eq!(drain(&mut spool, at(0)).len() as u64, REORDER_MAX);
}

#[test]
fn after_a_long_outage_the_rate_and_one_window_are_sent() {
    let mut spool = Spool::new(limits(1_000, 100).with_rate(10).unwrap());
    let ids: Vec<_> = (0..30).map(|_| spool.offer(10, at(0))).collect();
    spool.connect();
    let mut sent = 0;
    for second in 3_600..3_620 {
        for output in drain(&mut spool, at(second)) {
            match output {
                Output::Send(id) => {
                    assert_eq!(id, ids[sent]);
                    sent += 1;
                    spool.acknowledge(id);
                }
                Output::End(..) => {}
            }
        }
        let seconds = second - 3_600;
        assert_eq!(sent as u64, 10 + seconds, "after {seconds} s");
        assert_eq!(spool.deadline(), Some(at(second + 1)));
    }
}

#[derive(Clone, Copy, Debug)]
enum Step {
    Offer(u64),
    Connect,
    Disconnect,
    Acknowledge(prop::sample::Index),
    Reject(prop::sample::Index),
    Pass(u64),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (1..15_u64).prop_map(Step::Offer),
        1 => Just(Step::Connect),
        1 => Just(Step::Disconnect),
        3 => any::<prop::sample::Index>().prop_map(Step::Acknowledge),
        1 => any::<prop::sample::Index>().prop_map(Step::Reject),
        2 => (0..20_u64).prop_map(Step::Pass),
    ]
}

/// The fate of each message, and the messages that the network has.
#[derive(Default)]
struct Oracle {
    /// Length and time of each message, and its fate.
    all: Vec<(u64, u64, Option<Fate>)>,
    /// Each with the time when it was sent.
    in_flight: Vec<(usize, u64)>,
}

proptest! {
    /// Each message has one fate, the account is balanced at any time, messages are sent in order, no limit is
    /// exceeded, and no message expires before its time or while there is room.
    #[test]
    fn every_message_has_one_fate(steps in vec(step(), 0..200), has_rate in any::<bool>()) {
        const MAX_BYTES: u64 = 50;
        const WINDOW_BYTES: u64 = 12;
        const AGE_S: u64 = 100;
        const RETRY_S: u64 = 10;
        const RATE: u64 = 5;
        let mut limits = limits(MAX_BYTES, WINDOW_BYTES)
            .with_max_age(SECOND * AGE_S as u32)
            .with_retry(SECOND * RETRY_S as u32);
        if has_rate {
            limits = limits.with_rate(RATE).unwrap();
        }
        let mut spool = Spool::new(limits);
        let (mut oracle, mut now) = (Oracle::default(), 1_000);
        let (mut sends, mut is_connected) = (Vec::new(), false);
        for step in steps {
            // Before a message expires for want of room, there is too little of it.
            let mut is_short = false;
            match step {
                Step::Offer(len) => {
                    is_short = spool.spooled_bytes() + len > MAX_BYTES;
                    let id = spool.offer(len, at(now));
                    prop_assert_eq!(id.0, oracle.all.len() as u64);
                    oracle.all.push((len, now, None));
                }
                Step::Connect => {
                    spool.connect();
                    is_connected = true;
                }
                Step::Disconnect => {
                    is_short = spool.spooled_bytes() + spool.in_flight_bytes() > MAX_BYTES;
                    spool.disconnect(at(now));
                    is_connected = false;
                    oracle.in_flight.clear();
                }
                Step::Acknowledge(index) if !oracle.all.is_empty() => {
                    spool.acknowledge(Id(index.index(oracle.all.len()) as u64));
                }
                Step::Reject(index) if !oracle.all.is_empty() => {
                    spool.reject(Id(index.index(oracle.all.len()) as u64));
                }
                Step::Acknowledge(_) | Step::Reject(_) => {}
                Step::Pass(seconds) => {
                    now += seconds;
                    if oracle.in_flight.first().is_some_and(|(_, sent)| now >= sent + RETRY_S) {
                        is_short = spool.spooled_bytes() + spool.in_flight_bytes() > MAX_BYTES;
                        oracle.in_flight.clear();
                    }
                }
            }
            prop_assert!(spool.counts().is_balanced());
            for output in drain(&mut spool, at(now)) {
                match output {
                    Output::Send(Id(id)) => {
                        let id = id as usize;
                        prop_assert!(is_connected);
                        prop_assert!(oracle.all[id].2.is_none());
                        prop_assert!(oracle.in_flight.last().is_none_or(|(last, _)| *last < id));
                        // No older message waits.
                        let flies = |id: &usize| oracle.in_flight.iter().any(|(it, _)| it == id);
                        let waits = |older: &usize| oracle.all[*older].2.is_none() && !flies(older);
                        prop_assert_eq!((0..id).find(waits), None);
                        oracle.in_flight.push((id, now));
                        sends.push((now, oracle.all[id].0));
                    }
                    Output::End(Id(id), fate) => {
                        let (len, offered, its_fate) = &mut oracle.all[id as usize];
                        prop_assert_eq!(*its_fate, None, "a second fate");
                        match fate {
                            Fate::Expired => prop_assert!(is_short || now >= *offered + AGE_S),
                            Fate::Refused => prop_assert!(*len > WINDOW_BYTES || matches!(step, Step::Reject(_))),
                            Fate::HandedOver => prop_assert!(matches!(step, Step::Acknowledge(_))),
                        }
                        *its_fate = Some(fate);
                        oracle.in_flight.retain(|(it, _)| *it != id as usize);
                    }
                }
            }
            prop_assert!(spool.deadline().is_none_or(|it| it > at(now)), "a task was left");
            prop_assert!(spool.spooled_bytes() <= MAX_BYTES);
            prop_assert!(spool.in_flight_bytes() <= WINDOW_BYTES);
            let flying: u64 = oracle.in_flight.iter().map(|(it, _)| oracle.all[*it].0).sum();
            prop_assert_eq!(spool.in_flight_bytes(), flying);
        }
        let open = oracle.all.iter().filter(|it| it.2.is_none()).count() as u64;
        let counts = spool.counts();
        prop_assert_eq!(counts.spooled + counts.in_flight, open);
        if has_rate {
            for (first, (since, _)) in sends.iter().enumerate() {
                let mut sum = 0;
                for (until, len) in &sends[first..] {
                    sum += len;
                    prop_assert!(sum <= WINDOW_BYTES + RATE * (until - since), "a flood");
                }
            }
        }
    }
}
