//! Deadlines: which offers fulfil which demands, and which periods count as missed (SM2-QOS-009).

use std::time::Duration;

use crate::link_support::{config, drain, open_to, opened, tick_link, with_ring};
use crate::ring_support::{RECEIVER, Rig};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Code, Datagram, Instant, Machine, Newest, Period, QosWatch,
    link::{
        Config, Input, Link, NoMemory, Role, Status,
        wire::{Carrier, Form, Frame, MessageFrame},
    },
};

//= SM2-QOS-009 test
#[test]
fn offers_are_at_most_demands() {
    for (offered, demanded, expected) in [
        (0, 0, true),
        (0, 5, false),
        (5, 0, true),
        (4, 5, true),
        (5, 5, true),
        (6, 5, false),
        (u64::MAX, u64::MAX, true),
        (1, u64::MAX, true),
    ] {
        let fulfils = Period(offered).fulfils(Period(demanded));
        assert_eq!(fulfils, expected, "{offered} for {demanded}");
    }
}

#[test]
fn periods_are_durations_in_range() {
    assert_eq!(Period::new(Duration::ZERO), Period(1));
    assert_eq!(Period::new(Duration::from_millis(2)), Period(2_000_000));
    assert_eq!(Period::new(Duration::MAX), Period(u64::MAX));
    assert_eq!(Period(2_000_000).get(), Some(Duration::from_millis(2)));
    assert_eq!(Period::NONE.get(), None);
    assert_eq!(Period(1_500_000_000).to_string(), "1.5s");
    assert_eq!(Period::NONE.to_string(), "none");
    assert_eq!(watch(Period::NONE.0, 3).due(), None);
}

/// Watches this deadline alone.
fn watch(period: u64, from: u64) -> QosWatch {
    QosWatch::new(Period(period), Period::NONE, Instant(from))
}

/// The number of whole periods between consecutive moments; the last one is now.
fn gaps(moments: &[u64], period: u64) -> u64 {
    moments.windows(2).map(|it| (it[1] - it[0]) / period).sum()
}

proptest! {
    /// Checks at any times between publications count the same periods.
    //= SM2-QOS-009 test
    #[test]
    fn a_publisher_counts_whole_periods_between_publications(
        period in 1..20_u64,
        steps in vec((0..30_u64, any::<bool>()), 0..60),
    ) {
        let mut watch = watch(period, 7);
        let (mut now, mut moments) = (7, vec![7]);
        for (step, publishes) in steps {
            now += step;
            if publishes {
                watch.published(Instant(now));
                moments.push(now);
            } else {
                watch.check(Newest::NONE, Instant(now));
                let all: Vec<_> = moments.iter().copied().chain([now]).collect();
                prop_assert_eq!(watch.missed_deadlines(), gaps(&all, period));
            }
            prop_assert!(publishes || watch.due() > Some(Instant(now)));
        }
        moments.push(now);
        watch.check(Newest::NONE, Instant(now));
        prop_assert_eq!(watch.missed_deadlines(), gaps(&moments, period));
    }

    /// A receiver that is ticked in time counts what its publisher counts, on the socket lane.
    //= SM2-QOS-009 test
    #[test]
    fn a_receiver_counts_whole_periods_between_messages(
        period in 1..20_u64,
        steps in vec(0..50_u64, 0..40),
    ) {
        let mut link = receiver(period, Instant(7));
        let (mut now, mut moments) = (7, vec![7]);
        for (step, sequence) in steps.into_iter().zip(1..) {
            now += step;
            tick_until(&mut link, now);
            data(&mut link, sequence, Instant(now), Instant(now));
            moments.push(now);
        }
        tick_until(&mut link, now + period + 1);
        moments.push(now + period + 1);
        prop_assert_eq!(link.watch().missed_deadlines(), gaps(&moments, period));
    }
}

fn with_deadline(config: Config, period: u64) -> Config {
    Config {
        deadline: Period(period),
        ..config
    }
}

/// A receiver whose link opens at that time.
fn receiver(period: u64, opened: Instant) -> Link {
    let config = with_deadline(config(Role::Receiver), period);
    let mut link = Link::new(config);
    drain(&mut link);
    assert_eq!(link.deadline(), None);
    let open = open_to(&config).to_vec();
    let input = Input::Datagram(Datagram::new(&open));
    assert_eq!(link.handle(opened, input), Ok(()));
    drain(&mut link);
    link
}

/// Ticks the link whenever it asks for that, up to this time.
fn tick_until(link: &mut Link, end: u64) {
    while let Some(due) = link.deadline().filter(|due| due.0 <= end) {
        tick_link(link, due, &NoMemory);
        assert!(link.deadline() > Some(due));
    }
}

/// A message that was published at `time` comes.
fn data(link: &mut Link, sequence: u64, time: Instant, now: Instant) {
    let frame = Frame::Message(MessageFrame {
        carrier: Carrier::Data,
        form: Form::Inline,
        status: Status::Ok,
        sequence,
        id: sequence,
        time,
        len: 0,
        rest: &[],
    });
    let bytes = frame.to_vec();
    let input = Input::Datagram(Datagram::new(&bytes));
    assert_eq!(link.handle(now, input), Ok(()));
    drain(link);
    if let Ok(Some(taken)) = link.take(&NoMemory) {
        let _ = link.release(&NoMemory, taken.sequence).unwrap();
        drain(link);
    }
}

//= SM2-QOS-009 test
#[test]
fn times_before_the_opening_and_in_the_future_do_not_count() {
    let mut link = receiver(10, Instant(100));
    // A latched message: the period that began with the opening goes on.
    data(&mut link, 1, Instant(3), Instant(101));
    tick_link(&mut link, Instant(109), &NoMemory);
    assert_eq!(link.watch().missed_deadlines(), 0);
    tick_link(&mut link, Instant(110), &NoMemory);
    assert_eq!(link.watch().missed_deadlines(), 1);
    // A publisher whose times are wrong gains no more than a period.
    data(&mut link, 2, Instant(u64::MAX), Instant(111));
    tick_link(&mut link, Instant(120), &NoMemory);
    assert_eq!(
        (link.watch().missed_deadlines(), link.deadline()),
        (1, Some(Instant(130)))
    );
    tick_link(&mut link, Instant(140), &NoMemory);
    assert_eq!(
        (link.watch().missed_deadlines(), link.deadline()),
        (1, Some(Instant(150)))
    );
}

//= SM2-QOS-009 test
#[test]
fn a_receiver_that_looks_late_counts_all_periods_without_a_message() {
    let mut link = receiver(10, Instant(0));
    tick_link(&mut link, Instant(39), &NoMemory);
    assert_eq!(
        (link.watch().missed_deadlines(), link.deadline()),
        (3, Some(Instant(40)))
    );
    // Nobody knows which messages came in time, so it does not accuse the publisher.
    data(&mut link, 1, Instant(95), Instant(97));
    tick_link(&mut link, Instant(99), &NoMemory);
    assert_eq!(
        (link.watch().missed_deadlines(), link.deadline()),
        (3, Some(Instant(105)))
    );
}

//= SM2-QOS-009 test
#[test]
fn only_an_open_receiver_has_a_deadline() {
    for role in Role::ALL {
        let mut link = opened(with_deadline(config(role), 10));
        assert_eq!(link.deadline().is_some(), role == Role::Receiver);
        tick_link(&mut link, Instant(25), &NoMemory);
        let missed = if role == Role::Receiver { 2 } else { 0 };
        assert_eq!(link.watch().missed_deadlines(), missed);
        link.handle(Instant(26), Input::Close(Code(0))).unwrap();
        drain(&mut link);
        assert_eq!(link.deadline(), None);
        tick_link(&mut link, Instant(99), &NoMemory);
        assert_eq!(link.watch().missed_deadlines(), missed, "the count stays");
    }
    assert_eq!(opened(config(Role::Receiver)).deadline(), None);
}

/// Both ends of a ring; the receiver has a deadline. The message with an id was published at 100 + id.
fn ring(period: u64) -> Rig {
    let receiver = Config {
        depth: 2,
        max_borrowed: 2,
        ..with_ring(Role::Receiver)
    };
    Rig::with([with_ring(Role::Sender), with_deadline(receiver, period)]).opened()
}

fn tick(rig: &mut Rig, now: u64) -> (u64, u64) {
    let receiver = &mut rig.ends[RECEIVER];
    tick_link(receiver, Instant(now), &rig.words);
    let due = receiver.deadline().expect("the link is open");
    (receiver.watch().missed_deadlines(), due.0)
}

//= SM2-QOS-009 test
#[test]
fn a_message_in_a_ring_counts_before_and_after_it_is_taken() {
    let mut rig = ring(50);
    assert_eq!(tick(&mut rig, 50), (1, 100));
    assert_eq!(tick(&mut rig, 100), (2, 150));
    let _ = rig.send(1, 1).unwrap();
    // It waits in the ring, so its time is not known.
    assert_eq!(tick(&mut rig, 150), (2, 200));
    // Now it is known: 101.
    assert_eq!(rig.taken().id, 1);
    assert_eq!(tick(&mut rig, 200), (3, 201));
    // Two more, and the application takes none of them: only the first look at them sees new messages.
    let _ = rig.send(110, 2).unwrap();
    let _ = rig.send(111, 3).unwrap();
    assert_eq!(tick(&mut rig, 201), (3, 251));
    assert_eq!(tick(&mut rig, 251), (4, 301));
    // A message that displaces another one is new.
    let _ = rig.send(150, 4).unwrap();
    assert_eq!(tick(&mut rig, 301), (4, 351));
    assert_eq!(tick(&mut rig, 351), (5, 401));
}

#[test]
fn a_message_whose_time_is_not_known_begins_a_period() {
    let mut watch = watch(10, 0);
    let found = |sequence| Newest {
        sequence,
        time: None,
    };
    watch.check(found(0), Instant(10));
    assert_eq!(watch.missed_deadlines(), 1, "there was no message");
    watch.check(found(3), Instant(25));
    assert_eq!(
        (watch.missed_deadlines(), watch.due()),
        (1, Some(Instant(35)))
    );
    watch.check(found(3), Instant(35));
    assert_eq!(
        (watch.missed_deadlines(), watch.due()),
        (2, Some(Instant(45)))
    );
}
