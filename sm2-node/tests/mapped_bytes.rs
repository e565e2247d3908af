//! The bound of the bytes that a process maps for its peers. In its own process, because other tests map bytes, too.

// Shows DAT-LOCAL, DAT-COST (test), bound: one process.

use std::os::fd::AsFd;
use std::time::Duration;

use crate::common::raw::{attach, pooled, raw_publisher};
use crate::common::{Domain, SOON, pattern};
use sm2_proto::Farewell;
use sm2_test_support::ran_alone;

/// A publisher that attaches sparse segments leaves room for a newcomer, and loses its link when it
/// attaches one more than its part.
//= SM2-SEG-006 test
#[test]
fn a_peer_cannot_use_up_the_addresses_of_others() {
    if ran_alone(concat!(
        module_path!(),
        "::a_peer_cannot_use_up_the_addresses_of_others"
    )) {
        return;
    }
    const STRIDE: u64 = 1 << 32;
    const SLOTS: u32 = 16;
    let domain = Domain::new();
    let (raw, subscriber) = raw_publisher(&domain);
    let attach_next = |segment: u32| {
        let (fd, _slots) = sm2_io::Segment::create(STRIDE, SLOTS).unwrap().split();
        raw.send(&attach(segment, STRIDE, SLOTS), &[fd.as_fd()]);
    };
    // Half of the 1 TiB that a node maps by default, in segments of 64 GiB.
    (0..8).for_each(attach_next);
    raw.send(&pooled(7, 0, 1, 20), &[]);
    assert_eq!(*subscriber.recv_timeout(SOON).unwrap().unwrap(), [0; 20]);
    let newcomer = domain.node("talker").publisher::<[u8]>("topic").unwrap();
    while newcomer
        .wait_for_subscribers_timeout(1, Duration::from_millis(1))
        .is_err()
    {
        let _ = subscriber.links();
    }
    let meet = |seed| {
        newcomer.publish(&pattern(1 << 20, seed)).unwrap();
        let sample = subscriber.recv_timeout(SOON).unwrap().unwrap();
        assert!(*sample == *pattern(1 << 20, seed));
    };
    meet(1);
    attach_next(8);
    let code = raw.closed(|| drop(subscriber.try_recv().unwrap()));
    assert_eq!(code, Farewell::Resources.code().0);
    meet(2);
}
