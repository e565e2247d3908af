//! The queue of a connection, its count of descriptors, and its end.

use nix::libc;
use sm2_io::{
    RecvError,
    fault::{Call, Fault, Injector},
};

use super::*;

const FRAME: usize = 4_096;
/// The memory of a queued frame of that length.
const EACH: usize = size_of::<Parcel>() + FRAME;

fn connected() -> (Connection, SeqPacket) {
    let (here, there) = SeqPacket::pair().unwrap();
    let place = sm2_io::duplicate(&here).unwrap();
    (Connection::new(here, place, None), there)
}

fn frame(number: u8) -> Vec<u8> {
    vec![number; FRAME]
}

fn file() -> Arc<OwnedFd> {
    Arc::new(std::fs::File::open("/dev/null").unwrap().into())
}

/// Sends frames until one is queued. Returns how many the socket took.
fn fill(connection: &mut Connection) -> usize {
    let taken = || connection.send(frame(0), None, EACH) == Ok(Sent::Taken);
    std::iter::repeat_with(taken).take_while(|it| *it).count()
}

/// The first byte and the number of descriptors of the next datagram; `None` at the end of the connection.
fn next(socket: &SeqPacket) -> Option<(u8, usize)> {
    let mut buffer = vec![0; FRAME + 1];
    match socket.recv(&mut buffer) {
        Ok(received) => Some((buffer[0], received.fds.len())),
        Err(RecvError::Closed) => None,
        Err(error) => panic!("{error}"),
    }
}

//= SM2-TRN-008 test
#[test]
fn the_queue_has_room_for_what_the_limit_says_and_no_more() {
    let (mut connection, _there) = connected();
    assert!(fill(&mut connection) > 0);
    assert!(connection.is_waiting(), "one frame");
    assert_eq!(connection.send(frame(1), None, 3 * EACH), Ok(Sent::Full));
    assert_eq!(connection.send(frame(2), None, 3 * EACH), Ok(Sent::Full));
    let one_more = connection.send(Vec::new(), None, 3 * EACH);
    assert_eq!(
        one_more,
        Err(Lost::Stalled),
        "an empty frame occupies memory, too"
    );
}

//= SM2-TRN-008 test
#[test]
fn frames_that_were_sent_from_the_queue_make_room_in_it() {
    let (mut connection, there) = connected();
    let taken = fill(&mut connection);
    for number in [1, 2] {
        assert_eq!(
            connection.send(frame(number), None, 3 * EACH),
            Ok(Sent::Full)
        );
    }
    // The socket has room for one frame: the one that was queued first.
    assert_eq!(next(&there), Some((0, 0)));
    assert_eq!(connection.flush(), Ok(Sent::Full));
    assert_eq!(connection.waiting.len(), 2);
    assert_eq!(connection.send(frame(3), None, 3 * EACH), Ok(Sent::Full));
    assert_eq!(
        connection.send(frame(4), None, 3 * EACH),
        Err(Lost::Stalled)
    );
    for _ in 0..taken {
        assert_eq!(next(&there), Some((0, 0)));
    }
    assert_eq!(connection.flush(), Ok(Sent::Taken));
    assert!(!connection.is_waiting());
    for number in 1..=3 {
        assert_eq!(next(&there), Some((number, 0)), "in their order");
    }
}

//= SM2-TRN-008 test
#[test]
fn descriptors_that_wait_are_those_that_giving_up_would_close() {
    let (mut connection, there) = connected();
    let taken = fill(&mut connection);
    let shared = file();
    for fd in [Some(file()), Some(Arc::clone(&shared)), None, Some(file())] {
        assert_eq!(connection.send(frame(1), fd, 9 * EACH), Ok(Sent::Full));
    }
    assert_eq!(connection.waiting_fds(), 2);
    drop(shared);
    assert_eq!(connection.waiting_fds(), 3);
    connection.give_up();
    assert_eq!(connection.waiting_fds(), 0);
    assert!(!connection.is_waiting());
    // Nothing is sent any more, although nothing waits.
    for _ in 0..taken {
        assert_eq!(next(&there), Some((0, 0)));
    }
    assert_eq!(connection.send(frame(2), None, 0), Ok(Sent::Taken));
    drop(connection);
    assert_eq!(next(&there), None);
}

//= SM2-TRN-009 test
#[test]
fn unread_descriptors_are_those_since_the_peer_had_read_everything() {
    let (mut connection, there) = connected();
    let send = |connection: &mut Connection, fd: Option<Arc<OwnedFd>>| {
        assert_eq!(connection.send(vec![1], fd, EACH), Ok(Sent::Taken));
    };
    assert_eq!(connection.unread_fds(), 0);
    for _ in 0..40 {
        send(&mut connection, Some(file()));
    }
    assert_eq!(connection.unread_fds(), 40);
    for _ in 0..39 {
        assert_eq!(next(&there), Some((1, 1)));
    }
    let left = connection.unread_fds();
    assert!((1..10).contains(&left), "one datagram is unread: {left}");
    assert_eq!(next(&there), Some((1, 1)));
    // The first frame after that finds the socket empty.
    for _ in 0..20 {
        send(&mut connection, None);
    }
    send(&mut connection, Some(file()));
    assert_eq!(connection.unread_fds(), 1, "of 21 datagrams");
    while there.recv(&mut [0; 8]).is_ok() {}
    assert_eq!(connection.unread_fds(), 0);
}

//= SM2-TRN-009, SM2-TRN-012 test
#[test]
fn an_error_of_sending_costs_the_connection_only_if_it_is_the_peers() {
    for (errno, result, is_kept) in [
        (libc::EAGAIN, Ok(Sent::Full), true),
        (libc::ETOOMANYREFS, Ok(Sent::Crowded), true),
        (libc::ENOMEM, Ok(Sent::Short), true),
        (libc::ENOBUFS, Ok(Sent::Short), true),
        (libc::EPIPE, Err(Lost::Closed), false),
        (libc::ECONNRESET, Err(Lost::Closed), false),
        (libc::EIO, Err(Lost::Stalled), false),
        (libc::EMSGSIZE, Err(Lost::Stalled), false),
    ] {
        let (mut connection, there) = connected();
        let faults = Injector::new(Fault {
            call: Call::SendMsg,
            nth: 1,
            times: 1,
            errno,
        });
        let installed = faults.install();
        assert_eq!(
            connection.send(vec![1], Some(file()), EACH),
            result,
            "{errno}"
        );
        assert_eq!(connection.is_waiting(), is_kept, "{errno}");
        drop(installed);
        if is_kept {
            assert_eq!(connection.flush(), Ok(Sent::Taken), "{errno}");
            assert_eq!(next(&there), Some((1, 1)), "{errno}");
        }
    }
}

//= SM2-SES-005 test
#[test]
fn the_last_frame_comes_after_all_others_or_not_at_all() {
    let (connection, there) = connected();
    connection.say_goodbye(Some(vec![9]));
    assert_eq!(next(&there), Some((9, 0)));
    assert_eq!(next(&there), None);

    let (connection, there) = connected();
    connection.say_goodbye(None);
    assert_eq!(next(&there), None);

    for is_read in [true, false] {
        let (mut connection, there) = connected();
        let taken = fill(&mut connection);
        let count = if is_read { taken } else { 0 };
        for _ in 0..count {
            assert_eq!(next(&there), Some((0, 0)));
        }
        connection.say_goodbye(Some(vec![9]));
        let rest: Vec<_> = std::iter::from_fn(|| next(&there)).map(|it| it.0).collect();
        match is_read {
            true => assert_eq!(rest, [0, 9], "the frame that waited, then the last one"),
            false => assert_eq!(rest, vec![0; taken]),
        }
    }
}
