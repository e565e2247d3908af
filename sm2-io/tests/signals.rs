//! What signals do, and do not. Apart from the others: what a process does with a signal is one
//! setting for all its threads.

use std::io::IoSlice;
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};

use nix::libc;
use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, sigaction};
use sm2_io::{Epoll, Events, Interest, SendError, SeqPacket, Waker, wait_readable};

extern "C" fn do_nothing(_: libc::c_int) {}

fn on(signal: Signal, handler: SigHandler) {
    let action = SigAction::new(handler, SaFlags::empty(), SigSet::empty());
    // SAFETY: the handler is the default one, or does nothing.
    unsafe { sigaction(signal, &action) }.unwrap();
}

#[test]
fn sending_to_a_closed_socket_does_not_kill() {
    // Programs in Rust start with SIGPIPE ignored; those that embed this library may not. Linux
    // raises it for streams only, so this holds today even without MSG_NOSIGNAL.
    on(Signal::SIGPIPE, SigHandler::SigDfl);
    let (a, b) = SeqPacket::pair().unwrap();
    drop(b);
    let result = a.send(&[IoSlice::new(b"x")], &[]);
    assert!(matches!(result, Err(SendError::Closed)));
}

#[test]
fn a_signal_ends_a_wait_with_nothing() {
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
    // SAFETY: takes nothing, and always succeeds.
    let waiting = unsafe { libc::pthread_self() };
    std::thread::scope(|scope| {
        scope.spawn(|| {
            // Again and again, since one may come before the wait begins.
            while !done.load(Ordering::Relaxed) {
                // SAFETY: that thread waits for this one at the end of the scope.
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
