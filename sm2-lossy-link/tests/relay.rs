//! The relay that emulates a link without any rights behaves as its profile says. Plain UDP sockets measure it; which
//! datagrams it loses is measured in virtual time, in `lane.rs`.

use std::{
    net::{SocketAddr, UdpSocket},
    sync::atomic::{AtomicU32, Ordering},
    thread,
    time::Duration,
};

use sm2_lossy_link::{Kind, LossyLink, Pause, Profile, Side};
use sm2_test_support::{SOON, until};

use crate::numbered::{assert_changes, datagram, poll_only, profile, receive};

#[test]
fn a_link_that_is_cut_lets_nothing_through_and_loss_can_be_changed() {
    assert_changes(LossyLink::relay(profile()));
}

#[test]
fn a_relay_has_no_hosts_of_its_own() {
    let link = LossyLink::relay(profile());
    assert_eq!((link.kind(), link.kind().as_str()), (Kind::Relay, "relay"));
    assert_eq!(Kind::Namespaces.as_str(), "namespaces");
    assert_eq!(link.profile(), &profile());
    assert!(link.between().is_none());
    for side in [Side::Near, Side::Far] {
        assert!(link.host(side).is_none());
        assert_eq!(link.enter(side, || 7).unwrap(), 7);
    }
    assert_eq!(link.listen().to_string(), "127.0.0.1:0");
}

/// A near host with its socket, and the far socket.
struct Hosts {
    /// Lives as long as the sockets use it.
    _link: LossyLink,
    near: Vec<UdpSocket>,
    far: UdpSocket,
}

impl Hosts {
    /// Sockets of so many near addresses, over a link that loses nothing.
    fn new(count: usize) -> Self {
        let mut link = LossyLink::relay(Profile {
            loss_permille: 0,
            ..profile()
        });
        let bind = || {
            let socket = UdpSocket::bind(link.listen()).unwrap();
            socket.set_read_timeout(Some(SOON)).unwrap();
            socket
        };
        let (near, far) = (Vec::from_iter((0..count).map(|_| bind())), bind());
        let address = link.connect(far.local_addr().unwrap()).unwrap();
        for socket in &near {
            socket.connect(address).unwrap();
        }
        Self {
            _link: link,
            near,
            far,
        }
    }

    /// Sends from a near address. Returns the address that the far host sees.
    fn seen(&self, from: usize) -> SocketAddr {
        self.near[from].send(&[from as u8]).unwrap();
        let mut buffer = [0; 2];
        let (len, address) = self.far.recv_from(&mut buffer).unwrap();
        assert_eq!((len, buffer[0]), (1, from as u8));
        address
    }

    /// Asserts that an answer to this address reaches this near one, and no earlier answer does.
    fn assert_answered(&self, at: SocketAddr, near: usize, text: &str) {
        self.far.send_to(text.as_bytes(), at).unwrap();
        let mut buffer = [0; 20];
        let len = self.near[near].recv(&mut buffer).unwrap();
        assert_eq!(&buffer[..len], text.as_bytes(), "{near}");
    }
}

/// As behind a router with address translation.
#[test]
fn each_near_address_keeps_a_port_of_its_own() {
    let hosts = Hosts::new(3);
    let addresses = [0, 1, 2].map(|it| hosts.seen(it));
    assert!(addresses[0] != addresses[1] && addresses[1] != addresses[2]);
    for near in [2, 0, 1, 1] {
        assert_eq!(hosts.seen(near), addresses[near]);
        hosts.assert_answered(addresses[near], near, "answer");
    }
}

/// A near host that moves uses one address after another, so the relay forgets the oldest of sixteen.
#[test]
fn the_seventeenth_near_address_takes_the_place_of_the_oldest() {
    let hosts = Hosts::new(17);
    let addresses = Vec::from_iter((0..16).map(|it| hosts.seen(it)));
    for (near, address) in addresses.iter().enumerate() {
        assert_eq!(hosts.seen(near), *address, "all sixteen are known");
    }
    let last = hosts.seen(16);
    for (near, address) in addresses.iter().enumerate().skip(1) {
        assert_eq!(hosts.seen(near), *address);
    }
    hosts.assert_answered(last, 16, "answer");
    // Nothing reaches the oldest one under its old address. Its next datagram gives it another one.
    let _ = hosts.far.send_to(b"lost", addresses[0]);
    let address = hosts.seen(0);
    hosts.assert_answered(address, 0, "marker");
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
