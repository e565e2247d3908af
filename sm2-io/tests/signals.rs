//! The effect of signals. Alone in its process: a signal's disposition is shared by all threads.

use sm2_test_support::ran_alone;
use std::io::IoSlice;
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};

use nix::libc;
use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, sigaction};
use sm2_io::{Epoll, Events, Interest, SendError, SeqPacket, Waker, wait_readable};

extern "C" fn do_nothing(_: libc::c_int) {}

fn on(signal: Signal, handler: SigHandler) {
    let action = SigAction::new(handler, SaFlags::empty(), SigSet::empty());
    // SAFETY: the handler is the default one or an empty function.
    unsafe { sigaction(signal, &action) }.unwrap();
}

#[test]
fn sending_to_a_closed_socket_does_not_kill() {
    if ran_alone(concat!(
        module_path!(),
        "::sending_to_a_closed_socket_does_not_kill"
    )) {
        return;
    }
    // Rust programs start with SIGPIPE ignored, but programs that embed this library may not. Linux raises it
    // for streams only, so this test passes even without MSG_NOSIGNAL.
    on(Signal::SIGPIPE, SigHandler::SigDfl);
    let (a, b) = SeqPacket::pair().unwrap();
    drop(b);
    let result = a.send(&[IoSlice::new(b"x")], &[]);
    assert!(matches!(result, Err(SendError::Closed)));
}

#[test]
fn a_signal_ends_a_wait_with_nothing() {
    if ran_alone(concat!(
        module_path!(),
        "::a_signal_ends_a_wait_with_nothing"
    )) {
        return;
    }
    on(Signal::SIGUSR1, SigHandler::Handler(do_nothing));
    let waker = Waker::new().unwrap();
    let epoll = Epoll::new().unwrap();
    epoll.add(&waker, 0, Interest::READABLE).unwrap();
    let mut events = Events::with_capacity(1);
    waker.wake();
    epoll.wait(&mut events, None).unwrap();
    assert_eq!(events.len(), 1);
    waker.drain();

    let done = AtomicBool::new(false);
    // SAFETY: the call has no arguments and always succeeds.
    let waiting = unsafe { libc::pthread_self() };
    std::thread::scope(|scope| {
        scope.spawn(|| {
            // Sends the signal repeatedly: it may arrive before the wait begins.
            while !done.load(Ordering::Relaxed) {
                // SAFETY: that thread is joined at the end of the scope, so it still exists.
                let result = unsafe { libc::pthread_kill(waiting, libc::SIGUSR1) };
                assert_eq!(result, 0);
                std::thread::yield_now();
            }
        });
        epoll.wait(&mut events, None).unwrap();
        let readable = wait_readable(&[waker.as_fd()], None).unwrap();
        done.store(true, Ordering::Relaxed);
        assert!(events.is_empty() && !readable);
    });
}
