//! Gateways whose system calls fail because the kernel is short of memory.

use std::{
    mem, thread,
    time::{Duration, Instant},
};

use crate::common::{ALL, Domain, report, runtime};
use nix::libc;
use sm2_io::fault::{Call, Fault, Injector};
use sm2_test_support::{SOON, until};
use tokio::runtime::Runtime;

/// A runtime on whose threads the injector acts.
fn faulty_runtime(faults: &Injector) -> Runtime {
    let (builder, faults) = (tokio::runtime::Builder::new_multi_thread(), faults.clone());
    { builder }
        .worker_threads(2)
        .enable_all()
        // For the life of the thread.
        .on_thread_start(move || mem::forget(faults.install()))
        .build()
        .unwrap()
}

/// The datagrams wait in the socket: the gateway receives them later, on the same connection.
#[test]
fn a_gateway_receives_datagrams_again_after_a_shortage() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let faults = Injector::counting();
    let (runtime, faulty) = (runtime(), faulty_runtime(&faults));
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    let mut right = far.gateway(&faulty, &[(&near, Some(left.address()))], ALL);
    let talker = near.node("talker");
    let publisher = talker.publisher::<u64>("chatter").unwrap();
    let listener = far.node("listener");
    let subscriber = listener.subscriber::<u64>("chatter").unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    let fail = |errno, times| {
        faults.set([Fault {
            call: Call::UdpRecv,
            nth: 1,
            times,
            errno,
        }]);
    };
    for (number, errno) in [(1, libc::ENOMEM), (2, libc::ENOBUFS)] {
        fail(errno, 4);
        publisher.publish(&number).unwrap();
        let sample = subscriber.recv_timeout(SOON).unwrap().expect("in time");
        assert_eq!(*sample, number);
        assert_eq!(faults.hits(), 4);
    }
    // As long as the shortage lasts, the gateway pauses between its tries.
    fail(libc::ENOMEM, u64::MAX);
    publisher.publish(&3).unwrap();
    let begin = Instant::now();
    until("a try", || faults.hits() > 0);
    thread::sleep(Duration::from_millis(100));
    // The pauses double from 10 ms to 1 s, by chance down to the half. On a busy machine there is more time for tries.
    let tries = faults.hits();
    let passed = begin.elapsed();
    let most = 16 + passed.as_millis() / 250;
    assert!(u128::from(tries) <= most, "{tries} tries in {passed:?}");
    faults.set(None);
    let sample = subscriber.recv_timeout(SOON).unwrap().expect("in time");
    assert_eq!(*sample, 3);

    let ended = async { tokio::time::timeout(Duration::ZERO, right.ended()).await };
    assert!(faulty.block_on(ended).is_err());
    let peers = report(&runtime, &left).peers;
    assert_eq!((peers[0].messages.sent, peers[0].messages.lost), (3, 0));
    runtime.block_on(async { tokio::join!(left.stop(), right.stop()) });
}
