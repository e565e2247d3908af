//! Waiting with epoll: the reported events, and the end of a wait.

use std::io::{self, IoSlice, Write};
use std::net::Shutdown;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use nix::time::{ClockId, clock_gettime};
use sm2_io::clock::now;
use sm2_io::{Epoll, Event, Events, Interest, SeqPacket, Waker, poll_now, wait_readable};
use sm2_test_support::SOON;

const NO_TIME: Option<Duration> = Some(Duration::ZERO);

fn poll(epoll: &Epoll) -> Vec<Event> {
    let mut events = Events::with_capacity(8);
    epoll.wait(&mut events, NO_TIME).unwrap();
    assert_eq!(
        (events.len(), events.is_empty()),
        (events.iter().len(), events.iter().len() == 0)
    );
    events.iter().collect()
}

fn send(socket: &SeqPacket) {
    socket.send(&[IoSlice::new(b"x")], &[]).unwrap();
}

const READABLE: Event = Event {
    token: 0,
    readable: true,
    writable: false,
    hangup: false,
};

#[test]
fn readable_for_as_long_as_there_is_something() {
    let (a, b) = SeqPacket::pair().unwrap();
    let epoll = Epoll::new().unwrap();
    epoll.add(&b, u64::MAX, Interest::READABLE).unwrap();
    assert_eq!(poll(&epoll), []);
    send(&a);
    let token = u64::MAX;
    for _ in 0..2 {
        assert_eq!(poll(&epoll), [Event { token, ..READABLE }]);
    }
    b.recv(&mut [0; 8]).unwrap();
    assert_eq!(poll(&epoll), []);
}

#[test]
fn an_edge_is_reported_once() {
    let (a, b) = SeqPacket::pair().unwrap();
    let epoll = Epoll::new().unwrap();
    epoll.add(&b, 0, Interest::READABLE.edge()).unwrap();
    for _ in 0..2 {
        send(&a);
        assert_eq!(poll(&epoll), [READABLE]);
        assert_eq!(poll(&epoll), []);
    }
}

#[test]
fn interest_and_token_can_be_changed() {
    let (a, b) = SeqPacket::pair().unwrap();
    let epoll = Epoll::new().unwrap();
    send(&a);
    epoll.add(&b, 1, Interest::NONE).unwrap();
    assert_eq!(poll(&epoll), []);
    let writable = Event {
        token: 2,
        readable: false,
        writable: true,
        hangup: false,
    };
    epoll.modify(&b, 2, Interest::WRITABLE).unwrap();
    assert_eq!(poll(&epoll), [writable]);
    epoll.modify(&b, 3, Interest::BOTH).unwrap();
    let both = Event {
        token: 3,
        readable: true,
        ..writable
    };
    assert_eq!(poll(&epoll), [both]);
    epoll.remove(&b).unwrap();
    assert_eq!(poll(&epoll), []);
}

#[test]
fn a_full_socket_is_not_writable() {
    let (a, b) = SeqPacket::pair().unwrap();
    let epoll = Epoll::new().unwrap();
    epoll.add(&a, 0, Interest::WRITABLE).unwrap();
    while a.send(&[IoSlice::new(&[0; 1000])], &[]).is_ok() {}
    assert_eq!(poll(&epoll), []);
    while b.recv(&mut [0; 1000]).is_ok() {}
    assert!(poll(&epoll)[0].writable);
}

#[test]
fn a_peer_that_is_gone_is_a_reason_to_read() {
    for interest in [Interest::NONE, Interest::READABLE, Interest::BOTH] {
        let (a, b) = SeqPacket::pair().unwrap();
        let epoll = Epoll::new().unwrap();
        epoll.add(&b, 0, interest).unwrap();
        drop(a);
        let [event] = poll(&epoll)[..] else {
            panic!("no event for {interest:?}");
        };
        assert!(event.hangup && event.readable);
    }
}

#[test]
fn a_set_can_be_watched_by_another() {
    let waker = Waker::new().unwrap();
    let (inner, outer) = (Epoll::new().unwrap(), Epoll::new().unwrap());
    inner.add(&waker, 1, Interest::READABLE).unwrap();
    outer.add(&inner, 2, Interest::READABLE).unwrap();
    assert_eq!(poll(&outer), []);
    waker.wake();
    assert_eq!(
        poll(&outer),
        [Event {
            token: 2,
            ..READABLE
        }]
    );
}

#[test]
fn what_does_not_fit_is_reported_later() {
    let wakers: Vec<_> = (0..3).map(|_| Waker::new().unwrap()).collect();
    let epoll = Epoll::new().unwrap();
    for (token, waker) in (0..).zip(&wakers) {
        epoll.add(waker, token, Interest::READABLE).unwrap();
        waker.wake();
    }
    let mut events = Events::with_capacity(0);
    let mut seen = Vec::new();
    for _ in &wakers {
        epoll.wait(&mut events, None).unwrap();
        assert_eq!(events.len(), 1);
        for event in events.iter() {
            wakers[usize::try_from(event.token).unwrap()].drain();
            seen.push(event.token);
        }
    }
    seen.sort_unstable();
    assert_eq!(seen, [0, 1, 2]);
    epoll.wait(&mut events, NO_TIME).unwrap();
    assert!(events.is_empty(), "the old events are gone");
}

#[test]
fn misuse_has_names() {
    let waker = Waker::new().unwrap();
    let epoll = Epoll::new().unwrap();
    let kind = |result: io::Result<()>| result.unwrap_err().kind();
    assert_eq!(kind(epoll.remove(&waker)), io::ErrorKind::NotFound);
    assert_eq!(
        kind(epoll.modify(&waker, 0, Interest::BOTH)),
        io::ErrorKind::NotFound
    );
    epoll.add(&waker, 0, Interest::BOTH).unwrap();
    let again = epoll.add(&waker, 0, Interest::BOTH);
    assert_eq!(kind(again), io::ErrorKind::AlreadyExists);
    let file = tempfile::tempfile().unwrap();
    let never = epoll.add(&file, 0, Interest::BOTH);
    assert_eq!(kind(never), io::ErrorKind::PermissionDenied);
}

#[test]
fn a_wait_does_not_end_early() {
    let epoll = Epoll::new().unwrap();
    let mut events = Events::with_capacity(1);
    for micros in [1, 300, 1500] {
        let timeout = Duration::from_micros(micros);
        let start = now();
        epoll.wait(&mut events, Some(timeout)).unwrap();
        assert!(now().since(start) >= timeout && events.is_empty());
        let start = now();
        assert!(!wait_readable(&[], Some(timeout)).unwrap());
        assert!(now().since(start) >= timeout);
    }
}

#[test]
fn the_longest_timeout_is_accepted() {
    let waker = Waker::new().unwrap();
    waker.wake();
    let epoll = Epoll::new().unwrap();
    epoll.add(&waker, 0, Interest::READABLE).unwrap();
    let mut events = Events::with_capacity(1);
    epoll.wait(&mut events, Some(Duration::MAX)).unwrap();
    assert_eq!(events.len(), 1);
    assert!(wait_readable(&[waker.as_fd()], Some(Duration::MAX)).unwrap());
}

#[test]
fn waiting_without_a_set() {
    // More than eight descriptors use an allocated list.
    for count in [1, 2, 8, 9, 20] {
        let wakers: Vec<_> = (0..count).map(|_| Waker::new().unwrap()).collect();
        let fds: Vec<_> = wakers.iter().map(AsFd::as_fd).collect();
        assert!(!wait_readable(&fds, NO_TIME).unwrap());
        for waker in &wakers {
            waker.wake();
            assert!(wait_readable(&fds, Some(SOON)).unwrap());
            waker.drain();
        }
        assert!(!wait_readable(&fds, NO_TIME).unwrap());
    }
    let (a, b) = SeqPacket::pair().unwrap();
    drop(a);
    assert!(wait_readable(&[b.as_fd()], Some(SOON)).unwrap(), "hung up");
}

#[test]
fn a_waker_wakes_another_thread_and_merges_calls() {
    let waker = Waker::new().unwrap();
    assert!(!waker.drain());
    for _ in 0..3 {
        waker.wake();
    }
    assert!(waker.drain());
    assert!(!waker.drain());
    std::thread::scope(|scope| {
        let waiter = scope.spawn(|| wait_readable(&[waker.as_fd()], Some(SOON)).unwrap());
        waker.wake();
        assert!(waiter.join().unwrap());
    });
}

#[test]
fn the_clock_is_the_hosts() {
    let kernel = || Duration::from(clock_gettime(ClockId::CLOCK_MONOTONIC).unwrap());
    let (before, moment, after) = (kernel(), now(), kernel());
    let moment = Duration::from_nanos(moment.0);
    assert!(before <= moment && moment <= after);
}

/// A look reports as an epoll does, for each interest, in each state of a socket.
#[test]
fn a_look_sees_what_an_epoll_reports() {
    let same_as_an_epoll = |fd: &UnixStream| {
        for interest in [
            Interest::READABLE,
            Interest::WRITABLE,
            Interest::BOTH,
            Interest::NONE,
        ] {
            let epoll = Epoll::new().unwrap();
            epoll.add(fd, 7, interest).unwrap();
            let reported = poll(&epoll).pop().map(|it| (it.readable, it.writable));
            let seen = poll_now(fd.as_fd(), interest).unwrap();
            assert_eq!(seen, reported.unwrap_or_default(), "{interest:?}");
        }
    };
    let (a, mut b) = UnixStream::pair().unwrap();
    same_as_an_epoll(&a);
    b.write_all(b"x").unwrap();
    same_as_an_epoll(&a);
    b.shutdown(Shutdown::Write).unwrap();
    same_as_an_epoll(&a);
    drop(b);
    same_as_an_epoll(&a);
}
