//! The emulated link behaves as its profile says. Plain UDP sockets measure it.

use std::{
    io::IoSlice,
    net::{SocketAddr, UdpSocket},
    process::Command,
    thread,
    time::Duration,
};

use nix::sys::socket::{ControlMessage, MsgFlags, SockaddrStorage, sendmsg, setsockopt, sockopt};
use std::os::fd::AsRawFd;

use sm2_lossy_link::{DEVICE, LossyLink, Namespace, Profile, Side, host_address};

use super::{common::until, world};

/// How many datagrams are sent each way.
const COUNT: u32 = 10_000;
/// How many of them are passed to the kernel at a time, as one segmented send.
const TRAIN: u32 = 10;
const LEN_BYTES: usize = 100;
/// If nothing arrives for this long, nothing more is expected.
const QUIET: Duration = Duration::from_secs(1);

fn profile() -> Profile {
    Profile {
        pauses: Vec::new(),
        ..Profile::wifi()
    }
}

/// Opens a socket at one host, with room for datagrams that arrive while the test waits for a
/// processor.
fn socket(link: &LossyLink, side: Side, is_ipv6: bool) -> UdpSocket {
    let address = SocketAddr::new(host_address(side, is_ipv6), 0);
    let socket = link
        .enter(side, || UdpSocket::bind(address))
        .unwrap()
        .unwrap();
    setsockopt(&socket, sockopt::RcvBufForce, &(32 << 20)).unwrap();
    socket.set_read_timeout(Some(QUIET)).unwrap();
    socket
}

/// Sends numbered datagrams: half of them one by one, half as trains that the kernel cuts into
/// datagrams.
fn send(socket: &UdpSocket) {
    let bytes: Vec<u8> = (0..COUNT).flat_map(datagram).collect();
    for (index, train) in bytes.chunks(LEN_BYTES * TRAIN as usize).enumerate() {
        if index % 2 == 0 {
            for one in train.chunks(LEN_BYTES) {
                socket.send(one).unwrap();
            }
        } else {
            let size = u16::try_from(LEN_BYTES).unwrap();
            sendmsg::<SockaddrStorage>(
                socket.as_raw_fd(),
                &[IoSlice::new(train)],
                &[ControlMessage::UdpGsoSegments(&size)],
                MsgFlags::empty(),
                None,
            )
            .unwrap();
        }
        thread::sleep(Duration::from_millis(1));
    }
}

fn datagram(number: u32) -> Vec<u8> {
    let mut bytes = number.to_le_bytes().to_vec();
    bytes.resize(LEN_BYTES, number as u8);
    bytes
}

/// Returns the numbers that arrive, until nothing has arrived for a while.
fn receive(socket: &UdpSocket) -> Vec<u32> {
    let mut numbers = Vec::new();
    let mut buffer = [0; 2_048];
    while let Ok(len) = socket.recv(&mut buffer) {
        let number = u32::from_le_bytes(*buffer.first_chunk().unwrap());
        assert_eq!(&buffer[..len], datagram(number), "damaged");
        numbers.push(number);
    }
    numbers
}

/// The share of lost datagrams is that of the profile, losses are independent, and the others
/// arrive once and in order.
fn assert_lossy(way: &str, mut numbers: Vec<u32>) {
    let lost = COUNT as usize - numbers.len();
    // Each processor has a queue of its own in the kernel, so datagrams can overtake each other where the scheduler
    // moves a thread that sends.
    let overtaken = numbers.windows(2).filter(|it| it[0] > it[1]).count();
    assert!(overtaken <= 10, "{way}: {overtaken} overtaken");
    numbers.sort_unstable();
    assert!(numbers.windows(2).all(|it| it[0] < it[1]), "{way}: twice");
    let ends = [numbers[0], COUNT - 1 - numbers[numbers.len() - 1]];
    let gaps = numbers.windows(2).filter(|it| it[1] - it[0] > 1).count()
        + ends.iter().filter(|it| **it > 0).count();
    world::say(&format!(
        "{way}: {lost} of {COUNT} datagrams lost, at {gaps} places"
    ));
    assert!((200..=700).contains(&lost), "{way}: {lost} of {COUNT} lost");
    // With independent losses, 4 % of the gaps are longer than one. If trains were lost whole, half
    // of them would be.
    assert!(4 * lost < 5 * gaps, "{way}: {lost} lost at {gaps} places");
}

#[test]
fn four_percent_are_lost_each_way_one_by_one_and_none_comes_twice_or_late() {
    let Some(mut link) = world::link(profile()) else {
        return;
    };
    for is_ipv6 in [false, true] {
        let [near, far] = [Side::Near, Side::Far].map(|side| socket(&link, side, is_ipv6));
        near.connect(link.connect(far.local_addr().unwrap()).unwrap())
            .unwrap();
        // The far socket learns the address to answer from the first datagram that arrives.
        let mut first = [0; 1];
        let from = loop {
            near.send(&[0]).unwrap();
            if let Ok((_, from)) = far.recv_from(&mut first) {
                break from;
            }
        };
        far.connect(from).unwrap();
        let name = if is_ipv6 { "IPv6" } else { "IPv4" };
        for (way, from, to) in [("there", &near, &far), ("back", &far, &near)] {
            let numbers = thread::scope(|scope| {
                scope.spawn(|| send(from));
                receive(to)
            });
            assert_lossy(&format!("{name} {way}"), numbers);
        }
    }
}

#[test]
fn a_link_that_is_cut_lets_nothing_through_and_loss_can_be_changed() {
    // The fallback relay needs no rights, and has to behave the same.
    let links = [world::link(profile()), Some(LossyLink::relay(profile()))];
    for mut link in links.into_iter().flatten() {
        let kind = link.kind().as_str();
        let bind = |side| {
            let bound = link.enter(side, || UdpSocket::bind(link.listen()));
            bound.unwrap().unwrap()
        };
        let [near, far] = [Side::Near, Side::Far].map(bind);
        near.connect(link.connect(far.local_addr().unwrap()).unwrap())
            .unwrap();
        far.set_read_timeout(Some(Duration::from_millis(500)))
            .unwrap();
        let arrived = || {
            for number in 0..100 {
                near.send(&datagram(number)).unwrap();
            }
            receive(&far).len()
        };
        link.set_loss(0.0).unwrap();
        assert_eq!(arrived(), 100, "{kind}");
        link.set_loss(50.0).unwrap();
        assert!((10..=90).contains(&arrived()), "{kind}");
        link.cut().unwrap();
        assert_eq!(arrived(), 0, "{kind}");
        link.set_loss(0.0).unwrap();
        assert_eq!(arrived(), 0, "{kind}: cut means cut");
        link.restore().unwrap();
        assert_eq!(arrived(), 100, "{kind}");
    }
}

#[test]
fn what_pauses_hold_up_comes_in_the_end_and_in_order() {
    let pause = sm2_lossy_link::Pause {
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
    far.set_read_timeout(Some(QUIET)).unwrap();
    let numbers = thread::scope(|scope| {
        scope.spawn(|| {
            for number in 0..500 {
                near.send(&datagram(number)).unwrap();
                thread::sleep(Duration::from_millis(2));
            }
        });
        receive(&far)
    });
    assert_eq!(numbers, Vec::from_iter(0..500));
}

/// A virtual cable disappears with the namespace of its other end.
#[test]
fn nothing_is_left_of_a_link_that_was_dropped() {
    let Some(link) = world::link(profile()) else {
        return;
    };
    let hosts = [Side::Near, Side::Far].map(|side| link.host(side).unwrap().clone());
    let has_cable = |host: &Namespace| {
        let show = || Command::new("ip").args(["link", "show", DEVICE]).output();
        host.enter(show).unwrap().unwrap().status.success()
    };
    assert!(hosts.iter().all(has_cable));
    drop(link);
    until("the middle is gone", || !hosts.iter().any(has_cable));
}
