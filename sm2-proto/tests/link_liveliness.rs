//! Liveliness: who counts as alive, and when (SM2-QOS-011), and ALIVE (SM2-QOS-012).

// Shows LNK-ALIVE (test), bound: cases, and sampled signs of life.

use crate::link_support::{config, drain, feed, open_to, opened, sent, tick_link, with_ring};
use crate::ring_support::{RECEIVER, Rig, SENDER};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Code, Datagram, Instant, Machine, Newest, Period, QosWatch,
    link::{
        Config, End, Error, Fate, Input, Link, Misuse, NoMemory, Role, Status,
        wire::{Carrier, Form, Frame, MessageFrame},
    },
    violation,
};

proptest! {
    /// Signs of life at any times, and checks whenever they are due: a program is alive exactly while its last sign
    /// is not older than its lease, as far as the last check tells.
    //= SM2-QOS-011 test
    #[test]
    fn a_program_is_alive_while_its_last_sign_is_young(
        lease in 1..20_u64,
        steps in vec(0..40_u64, 0..40),
    ) {
        let mut watch = QosWatch::new(Period::NONE, Period(lease), Instant(7));
        let (mut last, mut now, mut losses) = (7, 7, 0);
        for step in steps {
            let next = now + step;
            while let Some(Instant(due)) = watch.due().filter(|it| it.0 <= next) {
                now = due;
                let was_alive = watch.is_alive();
                watch.check(Newest::NONE, Instant(now));
                prop_assert_eq!(watch.is_alive(), now - last < lease);
                losses += u64::from(was_alive && !watch.is_alive());
                prop_assert!(watch.due() > Some(Instant(now)), "checks advance");
            }
            now = next;
            prop_assert!(!watch.is_alive() || now - last < lease, "noticed in time");
            watch.assert(Instant(now), Instant(now));
            last = now;
            prop_assert!(watch.is_alive(), "an assertion is noticed at once");
        }
        prop_assert_eq!(watch.lost_liveliness(), losses);
    }
}

#[test]
fn a_lease_of_nothing_is_not_watched() {
    let watch = QosWatch::new(Period::NONE, Period::NONE, Instant(3));
    assert_eq!((watch, watch.due()), (QosWatch::default(), None));
}

fn with_lease(config: Config, lease: u64) -> Config {
    Config {
        lease: Period(lease),
        ..config
    }
}

/// A receiver that demands this lease, and whose link opened at that time.
fn receiver(lease: u64, at: Instant) -> Link {
    let config = with_lease(config(Role::Receiver), lease);
    let mut link = Link::new(config);
    drain(&mut link);
    assert_eq!(link.deadline(), None);
    let open = open_to(&config).to_vec();
    let input = Input::Datagram(Datagram::new(&open));
    assert_eq!(link.handle(at, input), Ok(()));
    drain(&mut link);
    link
}

fn receive(link: &mut Link, frame: &Frame<'_>, now: u64) {
    let bytes = frame.to_vec();
    let input = Input::Datagram(Datagram::new(&bytes));
    assert_eq!(link.handle(Instant(now), input), Ok(()));
    drain(link);
}

fn alive(time: u64) -> Frame<'static> {
    let time = Instant(time);
    Frame::Alive { time }
}

fn data(sequence: u64, time: u64) -> Frame<'static> {
    Frame::Message(MessageFrame {
        carrier: Carrier::Data,
        form: Form::Inline,
        status: Status::Ok,
        sequence,
        id: sequence,
        time: Instant(time),
        len: 0,
        rest: &[],
    })
}

/// Whether the publisher is alive after a tick, how often it was not, and the time of the next tick.
fn tick(link: &mut Link, now: u64) -> (bool, u64, u64) {
    tick_link(link, Instant(now), &NoMemory);
    let due = link.deadline().expect("the link is open").0;
    (link.watch().is_alive(), link.watch().lost_liveliness(), due)
}

//= SM2-QOS-011 test
#[test]
fn messages_and_assertions_are_signs_of_life() {
    let mut link = receiver(10, Instant(100));
    assert_eq!(link.deadline(), Some(Instant(110)));
    receive(&mut link, &alive(105), 106);
    assert_eq!(tick(&mut link, 110), (true, 0, 115));
    receive(&mut link, &data(1, 108), 111);
    assert_eq!(tick(&mut link, 115), (true, 0, 118));
    assert_eq!(tick(&mut link, 118), (false, 1, 128));
    assert_eq!(tick(&mut link, 128), (false, 1, 138), "it is counted once");
    // A message is noticed at the next tick, an assertion at once.
    receive(&mut link, &data(2, 130), 130);
    assert!(!link.watch().is_alive());
    receive(&mut link, &alive(131), 131);
    assert!(link.watch().is_alive());
    assert_eq!(tick(&mut link, 138), (true, 1, 141));
    assert_eq!(tick(&mut link, 141), (false, 2, 151));
    // One that came too late is not a sign that it is alive now.
    receive(&mut link, &alive(145), 155);
    assert_eq!(tick(&mut link, 155), (false, 2, 165));
}

//= SM2-QOS-011 test
#[test]
fn a_time_in_the_future_counts_as_now() {
    let mut link = receiver(10, Instant(0));
    receive(&mut link, &alive(u64::MAX), 5);
    assert_eq!(tick(&mut link, 10), (true, 0, 15));
    assert_eq!(tick(&mut link, 15), (false, 1, 25));
}

//= SM2-QOS-011 test
#[test]
fn only_an_open_receiver_that_demands_a_lease_watches() {
    for role in Role::ALL {
        let mut link = opened(with_lease(config(role), 10));
        let watches = role == Role::Receiver;
        assert_eq!(link.deadline().is_some(), watches);
        tick_link(&mut link, Instant(25), &NoMemory);
        assert_eq!(link.watch().is_alive(), !watches);
        link.handle(Instant(26), Input::Close(Code(0))).unwrap();
        drain(&mut link);
        assert_eq!(link.deadline(), None);
        tick_link(&mut link, Instant(99), &NoMemory);
        assert_eq!(link.watch().lost_liveliness(), u64::from(watches));
    }
    assert_eq!(opened(config(Role::Receiver)).deadline(), None);
}

/// The times of a topic's QoS mean nothing for a service, so a link of one has none of them.
//= SM2-QOS-009, SM2-QOS-010, SM2-QOS-011 test
#[test]
fn links_of_services_have_no_times() {
    for role in [Role::Caller, Role::Server] {
        let link = opened(Config {
            deadline: Period(7),
            lifespan: Period(8),
            ..with_lease(config(role), 10)
        });
        let Config {
            deadline,
            lifespan,
            lease,
            ..
        } = *link.config();
        assert_eq!([deadline, lifespan, lease], [Period::NONE; 3], "{role:?}");
    }
}

/// The deadline and the lease are two periods of their own.
//= SM2-QOS-009, SM2-QOS-011 test
#[test]
fn the_first_of_deadline_and_lease_is_due() {
    let demanding = Config {
        deadline: Period(7),
        ..with_lease(config(Role::Receiver), 10)
    };
    let mut link = opened(demanding);
    assert_eq!(link.deadline(), Some(Instant(7)));
    assert_eq!(tick(&mut link, 7), (true, 0, 10));
    assert_eq!(tick(&mut link, 10), (false, 1, 14));
    assert_eq!(link.watch().missed_deadlines(), 1);
}

//= SM2-QOS-012 test
#[test]
fn only_a_receiver_that_demands_a_lease_takes_alive() {
    let refused = Error::Ended(End::Violation(violation!(WrongRole, "SM2-QOS-012")));
    for (lease, expected) in [(0, Err(refused)), (1, Ok(()))] {
        for config in [config(Role::Receiver), with_ring(Role::Receiver)] {
            let mut link = opened(with_lease(config, lease));
            assert_eq!(feed(&mut link, &alive(0).to_vec(), &[]), expected);
        }
    }
}

fn assert_at(link: &mut Link, time: u64) -> Result<(), Error> {
    link.handle(Instant(time), Input::Assert(Instant(time)))
}

fn packets(link: &mut Link) -> Vec<Vec<u8>> {
    sent(&drain(link)).iter().map(|it| it.to_vec()).collect()
}

//= SM2-QOS-012 test
#[test]
fn a_sender_tells_a_receiver_that_demands_a_lease() {
    let mut link = Link::new(with_lease(config(Role::Sender), 10));
    assert_eq!(assert_at(&mut link, 1), Err(Misuse::NotOpen.into()));
    for role in [Role::Receiver, Role::Caller, Role::Server] {
        let mut link = opened(config(role));
        assert_eq!(assert_at(&mut link, 1), Err(Misuse::WrongRole.into()));
    }
    let mut link = opened(config(Role::Sender));
    assert_eq!(assert_at(&mut link, 1), Ok(()));
    assert!(packets(&mut link).is_empty(), "nobody demands a lease");

    let mut link = opened(with_lease(config(Role::Sender), 10));
    assert_eq!(assert_at(&mut link, 1), Ok(()));
    assert_eq!(packets(&mut link), [alive(1).to_vec()]);
    // While the socket accepts nothing, the newest one waits.
    link.handle(Instant(2), Input::Blocked).unwrap();
    for time in [3, 4] {
        assert_eq!(assert_at(&mut link, time), Ok(()));
    }
    assert!(packets(&mut link).is_empty());
    link.handle(Instant(5), Input::Writable).unwrap();
    assert_eq!(packets(&mut link), [alive(4).to_vec()]);
}

/// A publication that a receiver does not get is a sign of life all the same.
//= SM2-QOS-012 test
#[test]
fn alive_is_sent_for_a_publication_that_is_not() {
    let inputs = [
        Input::Drop(Fate::Overwritten),
        Input::Drop(Fate::PoolLimit),
        Input::Drop(Fate::TooLong),
        Input::Drop(Fate::Expired),
    ];
    for (lease, expected) in [(0, vec![]), (10, vec![alive(7).to_vec()])] {
        for input in inputs.clone() {
            let mut link = opened(with_lease(config(Role::Sender), lease));
            link.handle(Instant(7), input).unwrap();
            assert_eq!(packets(&mut link), expected);
        }
    }
    // There is room, so the publication is not skipped.
    let reliable = Config {
        reliable: true,
        ..with_lease(config(Role::Sender), 10)
    };
    let mut link = opened(reliable);
    let refused = link.handle(Instant(7), Input::Drop(Fate::NoRoom));
    assert_eq!(refused, Err(Misuse::RoomLeft.into()));
    assert!(packets(&mut link).is_empty());
}

/// A program that asserts its liveliness often does not fill the socket of a receiver that reads seldom.
//= SM2-QOS-012 test
#[test]
fn alive_is_sent_once_in_a_quarter_of_the_lease() {
    let mut link = opened(with_lease(config(Role::Sender), 40));
    assert_eq!(assert_at(&mut link, 5), Ok(()));
    assert_eq!(
        (packets(&mut link), link.deadline()),
        (vec![alive(5).to_vec()], None)
    );
    for time in 6..15 {
        assert_eq!(assert_at(&mut link, time), Ok(()));
        assert!(packets(&mut link).is_empty());
        assert_eq!(link.deadline(), Some(Instant(15)));
    }
    tick_link(&mut link, Instant(14), &NoMemory);
    assert!(packets(&mut link).is_empty(), "too early");
    tick_link(&mut link, Instant(17), &NoMemory);
    assert_eq!(
        (packets(&mut link), link.deadline()),
        (vec![alive(14).to_vec()], None)
    );
    assert_eq!(assert_at(&mut link, 26), Ok(()));
    assert!(packets(&mut link).is_empty(), "the quarter began at 17");
    assert_eq!(assert_at(&mut link, 27), Ok(()));
    assert_eq!(packets(&mut link), [alive(27).to_vec()]);
    assert_eq!(assert_at(&mut link, 28), Ok(()));
    link.handle(Instant(29), Input::Close(Code(0))).unwrap();
    assert_eq!(link.deadline(), None);
}

/// Both ends of a ring, whose receiver demands a lease. The message with an id was published at 100 + id.
//= SM2-QOS-011 test
#[test]
fn a_message_in_a_ring_is_a_sign_of_life() {
    let receiver = Config {
        depth: 2,
        max_borrowed: 2,
        ..with_ring(Role::Receiver)
    };
    let ends = [with_ring(Role::Sender), receiver].map(|it| with_lease(it, 50));
    let mut rig = Rig::with(ends).opened();
    let tick = |rig: &mut Rig, now: u64| {
        let receiver = &mut rig.ends[RECEIVER];
        tick_link(receiver, Instant(now), &rig.words);
        (receiver.watch().is_alive(), receiver.deadline().unwrap().0)
    };
    assert_eq!(tick(&mut rig, 50), (false, 100));
    let _ = rig.send(1, 1).unwrap();
    // It waits in the ring, so its time is not known.
    assert_eq!(tick(&mut rig, 100), (true, 150));
    assert_eq!(tick(&mut rig, 150), (false, 200));
    // The time of a message that was taken is known: 170 counts, 101 does not.
    assert_eq!(rig.taken().id, 1);
    assert_eq!(tick(&mut rig, 200), (false, 250));
    let _ = rig.send(170, 2).unwrap();
    assert_eq!(rig.taken().id, 170);
    assert_eq!(tick(&mut rig, 300), (true, 320));
    assert_eq!(tick(&mut rig, 320), (false, 370));
    // ALIVE goes through the socket.
    let input = Input::Assert(Instant(371));
    rig.ends[SENDER].handle(Instant(371), input).unwrap();
    rig.drain(SENDER);
    let (packet, _) = rig.wires[SENDER].pop_back().expect("a packet");
    assert_eq!(packet, alive(371).to_vec());
    let input = Input::Datagram(Datagram::new(&packet));
    rig.ends[RECEIVER].handle(Instant(372), input).unwrap();
    assert!(rig.ends[RECEIVER].watch().is_alive());
}
