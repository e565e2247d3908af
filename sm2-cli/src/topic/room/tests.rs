use super::*;

const FULL: u64 = DEPTH as u64;

fn link(serial: u64, delivered: u64, in_flight: u64) -> (LinkId, Counters) {
    let counters = Counters {
        delivered,
        in_flight,
        ..Counters::default()
    };
    (LinkId { epoch: 1, serial }, counters)
}

fn at(seconds: u64) -> Instant {
    Instant(seconds * 1_000_000_000)
}

#[test]
fn room_is_what_the_fullest_link_has() {
    let mut room = Room::default();
    assert!(!room.take());
    assert!(room.look(at(0), [link(1, 0, FULL - 2), link(2, 0, 0)]));
    assert_eq!([room.take(), room.take(), room.take()], [true, true, false]);
    assert!(!room.look(at(0), [link(1, 0, FULL), link(2, 0, 0)]));
    assert!(!room.take());
    assert!(room.look(at(0), []));
    assert!(room.take());
}

#[test]
fn a_link_that_takes_nothing_is_waited_for_so_long() {
    let mut room = Room::default();
    assert!(!room.look(at(0), [link(1, 7, FULL)]));
    assert!(!room.look(at(9), [link(1, 7, FULL)]));
    // The subscriber received a message, so its timeout starts again.
    assert!(!room.look(at(9), [link(1, 8, FULL)]));
    assert!(!room.look(at(18), [link(1, 8, FULL)]));
    assert!(room.look(at(19), [link(1, 8, FULL)]));
    // After the timeout, only the other links delay the publisher.
    assert!(room.look(at(20), [link(1, 8, FULL), link(2, 0, 0)]));
    assert!(!room.look(at(21), [link(1, 8, FULL), link(2, 0, FULL)]));
    // The link delays the publisher again once the subscriber has received a message.
    assert!(!room.look(at(40), [link(1, 9, FULL)]));
}

#[test]
fn a_link_that_was_not_full_has_all_the_time() {
    let mut room = Room::default();
    assert!(room.look(at(0), [link(1, 0, 0)]));
    assert!(!room.look(at(100), [link(1, 0, FULL)]));
}

#[test]
fn long_messages_in_flight_fit_into_a_quarter_of_the_pool() {
    let mut room = Room::default();
    room.fit(1_000, 1);
    assert!(room.look(at(0), [link(1, 0, FULL - 1)]));
    room.fit(1_000, 100);
    assert!(!room.take());
    assert!(!room.look(at(0), [link(1, 0, 2)]));
    assert!(room.look(at(0), [link(1, 0, 1)]));
    assert_eq!([room.take(), room.take()], [true, false]);
    // There is always room for one.
    room.fit(1_000, 5_000);
    assert!(room.look(at(0), [link(1, 0, 0)]));
}
