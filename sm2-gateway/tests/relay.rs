//! The relay that emulates a link without any rights behaves as its profile says. Plain UDP sockets measure it; which
//! datagrams it loses is measured in virtual time, in `sm2-lossy-link`.

use std::{
    net::UdpSocket,
    sync::atomic::{AtomicU32, Ordering},
    thread,
    time::Duration,
};

use sm2_lossy_link::{LossyLink, Pause, Profile};
use sm2_test_support::until;

use crate::numbered::{assert_changes, datagram, poll_only, profile, receive};

#[test]
fn a_link_that_is_cut_lets_nothing_through_and_loss_can_be_changed() {
    assert_changes(LossyLink::relay(profile()));
}

#[test]
fn what_pauses_hold_up_comes_in_the_end_and_in_order() {
    const COUNT: u32 = if cfg!(feature = "slow") { 500 } else { 150 };
    /// As many as the buffer of a socket holds, and more than are sent during a pause.
    const AHEAD: u32 = 150;
    let pause = Pause {
        length: Duration::from_millis(100),
        every: Duration::from_millis(100),
    };
    let mut link = LossyLink::relay(Profile {
        pauses: vec![pause],
        loss_permille: 0,
        ..profile()
    });
    let [near, far] = [(); 2].map(|()| UdpSocket::bind(link.listen()).unwrap());
    near.connect(link.connect(far.local_addr().unwrap()).unwrap())
        .unwrap();
    poll_only(&far);
    let received = AtomicU32::new(0);
    let mut numbers = Vec::new();
    thread::scope(|scope| {
        scope.spawn(|| {
            for number in 0..COUNT {
                until("room", || received.load(Ordering::Relaxed) + AHEAD > number);
                near.send(&datagram(number)).unwrap();
                thread::sleep(Duration::from_millis(2));
            }
        });
        until("all datagrams", || {
            numbers.extend(receive(&far));
            received.store(numbers.len() as u32, Ordering::Relaxed);
            numbers.len() == COUNT as usize
        });
    });
    assert_eq!(numbers, Vec::from_iter(0..COUNT));
}
