//! The lifespan of messages: those that are older are neither sent nor handed out (SM2-QOS-010).

use crate::link_support;

use crate::link_support::{
    config, data, drain, feed, message, offer, open_with, opened, opened_with, release,
    release_all, reliable, send, sent, settled, tick_link, with_ring,
};
use crate::ring_support::{RECEIVER, Rig, SENDER};
use sm2_proto::{
    Code, Instant, Machine, Period, ViolationKind,
    link::{Config, Counters, End, Error, Fate, Input, Link, Misuse, NoMemory, Role, wire::Given},
    violation,
};

fn with_lifespan(config: Config, lifespan: u64) -> Config {
    Config {
        lifespan: Period(lifespan),
        lease: Period::NONE,
        ..config
    }
}

//= SM2-QOS-010 test
#[test]
fn a_message_expires_at_the_end_of_its_lifespan() {
    let time = Instant(100);
    for (lifespan, now, expected) in [
        (0, u64::MAX, false),
        (1, 100, false),
        (1, 101, true),
        (10, 109, false),
        (10, 110, true),
        (u64::MAX, u64::MAX, false),
        // A time in the future.
        (10, 5, false),
    ] {
        let link = opened(with_lifespan(config(Role::Receiver), lifespan));
        let expired = link.is_expired(time, || Instant(now));
        assert_eq!(expired, expected, "{lifespan} at {now}");
    }
    let plain = opened(config(Role::Receiver));
    assert!(!plain.is_expired(time, || panic!("reads no clock")));
    // Requests have deadlines instead.
    let server = opened(with_lifespan(config(Role::Server), 1));
    assert!(!server.is_expired(time, || panic!("reads no clock")));
}

//= SM2-QOS-010, SM2-MSG-004 test
#[test]
fn a_receiver_gives_an_expired_message_back() {
    let mut link = opened(with_lifespan(reliable(Role::Receiver), 10));
    for id in 1..=2 {
        link_support::accept(&mut link, &data(id, id));
    }
    let taken = link.take(&NoMemory).unwrap().unwrap();
    let _ = link.expire(&NoMemory, &taken).unwrap();
    let packets = sent(&drain(&mut link));
    assert_eq!(packets[0].to_vec(), release(Given::Expired, &[1]));
    let again = link.expire(&NoMemory, &taken);
    assert_eq!(again, Err(Error::Misuse(Misuse::NotBorrowed)));
    // It makes room for the next one: the application may hold one.
    let taken = link.take(&NoMemory).unwrap().unwrap();
    assert_eq!(taken.sequence, 2);
    link.handle(Instant(0), Input::Close(Code(0))).unwrap();
    drain(&mut link);
    assert!(matches!(
        link.expire(&NoMemory, &taken),
        Err(Error::Ended(_))
    ));
    assert_eq!(sent(&drain(&mut link)), []);
}

//= SM2-QOS-010, SM2-QOS-006 test
#[test]
fn a_sender_counts_what_its_receiver_gave_back_as_expired() {
    let mut link = opened(with_lifespan(config(Role::Sender), 10));
    send(&mut link, message(1));
    let outputs = release_all(&mut link, Given::Expired, &[1]);
    assert_eq!(settled(&outputs), [(1, Fate::Expired)]);
    let expected = Counters {
        offered: 1,
        expired: 1,
        ..Counters::default()
    };
    assert_eq!(link.counters(), expected);
    // Without a lifespan nothing expires.
    let mut plain = opened(config(Role::Sender));
    send(&mut plain, message(1));
    let error = feed(&mut plain, &release(Given::Expired, &[1]), &[]).unwrap_err();
    let bad_release = violation!(BadRelease, "SM2-QOS-010");
    assert_eq!(error, Error::Ended(End::Violation(bad_release)));
}

/// A sender whose window is one, with as many messages as fit: one was sent, two wait. Message n is published at n.
fn queued(config: Config) -> Link {
    let mut link = opened_with(config, &open_with(&config, 1));
    for id in 1..=3 {
        let mut message = message(id);
        message.time = Instant(id);
        send(&mut link, message);
    }
    assert!(!link.has_room(&NoMemory));
    link
}

//= SM2-QOS-010, SM2-QOS-006 test
#[test]
fn messages_that_wait_at_the_sender_expire() {
    let mut link = queued(with_lifespan(reliable(Role::Sender), 10));
    tick_link(&mut link, Instant(11), &NoMemory);
    assert!(!link.has_room(&NoMemory), "the sent one is the receiver's");
    assert_eq!(drain(&mut link), []);
    tick_link(&mut link, Instant(12), &NoMemory);
    assert!(link.has_room(&NoMemory), "one that waits has expired");
    assert_eq!(settled(&drain(&mut link)), [(2, Fate::Expired)]);
    // Each input expires messages as well, before any is sent.
    let bytes = release(Given::Consumed, &[1]);
    let input = Input::Datagram(sm2_proto::Datagram::new(&bytes));
    assert_eq!(link.handle(Instant(13), input), Ok(()));
    let outputs = drain(&mut link);
    assert_eq!(
        settled(&outputs),
        [(1, Fate::Delivered), (3, Fate::Expired)]
    );
    assert_eq!(sent(&outputs), []);
    let expected = Counters {
        offered: 3,
        delivered: 1,
        expired: 2,
        ..Counters::default()
    };
    assert_eq!(link.counters(), expected);
}

//= SM2-QOS-010 test
#[test]
fn without_a_lifespan_messages_wait() {
    let mut link = queued(reliable(Role::Sender));
    tick_link(&mut link, Instant(u64::MAX), &NoMemory);
    assert_eq!(drain(&mut link), []);
    assert_eq!(link.in_flight(), 3);
}

//= SM2-QOS-010, SM2-QOS-006 test
#[test]
fn a_publication_that_is_too_old_is_counted_and_not_sent() {
    let mut link = opened(with_lifespan(config(Role::Sender), 10));
    assert_eq!(link.handle(Instant(0), Input::Drop(Fate::Expired)), Ok(()));
    assert_eq!(drain(&mut link), []);
    assert_eq!((link.counters().offered, link.counters().expired), (1, 1));
    let mut receiver = opened(config(Role::Receiver));
    let wrong = receiver.handle(Instant(0), Input::Drop(Fate::Expired));
    assert_eq!(wrong, Err(Error::Misuse(Misuse::WrongRole)));
    assert_eq!(
        offer(&mut receiver, message(1)),
        Err(Misuse::WrongRole.into())
    );
}

fn rig(lifespans: [u64; 2]) -> Rig {
    let receiver = Config {
        depth: 3,
        max_borrowed: 2,
        ..with_ring(Role::Receiver)
    };
    let [ours, theirs] = lifespans;
    let sender = with_lifespan(with_ring(Role::Sender), ours);
    Rig::with([sender, with_lifespan(receiver, theirs)]).opened()
}

fn expire(rig: &mut Rig) {
    let taken = rig.taken();
    let _ = rig.ends[RECEIVER].expire(&rig.words, &taken).unwrap();
}

//= SM2-QOS-010, SM2-RNG-008, SM2-QOS-006 test
#[test]
fn a_back_word_says_that_its_message_has_expired() {
    let mut rig = rig([5, 5]);
    for id in 1..=3 {
        let _ = rig.send(id, id as u32).unwrap();
    }
    expire(&mut rig);
    let taken = rig.taken();
    let _ = rig.release(taken.sequence).unwrap();
    expire(&mut rig);
    let _ = rig.harvest().unwrap();
    assert_eq!(
        rig.settled(),
        [
            (10, Fate::Expired),
            (20, Fate::Delivered),
            (30, Fate::Expired)
        ]
    );
    let counters = rig.ends[SENDER].counters();
    assert_eq!((counters.expired, counters.delivered), (2, 1));
    assert_eq!(
        rig.ends[SENDER].handle(Instant(0), Input::Drop(Fate::Expired)),
        Ok(())
    );
    assert_eq!(rig.ends[SENDER].counters().expired, 3);
}

//= SM2-RNG-008 test
#[test]
fn a_back_word_cannot_say_so_without_a_lifespan() {
    let mut rig = rig([0, 5]);
    let _ = rig.send(1, 1).unwrap();
    expire(&mut rig);
    let error = rig.harvest().unwrap_err();
    let Error::Ended(End::Violation(violation)) = error else {
        panic!("{error:?}");
    };
    assert_eq!(violation.kind(), ViolationKind::BadWord);
}
