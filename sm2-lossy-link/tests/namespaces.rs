//! A link of namespaces behaves as its profile says. Plain UDP sockets measure it.

use std::{
    collections::BTreeSet,
    fs,
    io::IoSlice,
    net::{SocketAddr, UdpSocket},
    process::Command,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::Duration,
};

use nix::{
    sched::{CpuSet, sched_getaffinity, sched_setaffinity},
    sys::socket::{ControlMessage, MsgFlags, SockaddrStorage, sendmsg, setsockopt, sockopt},
    unistd::Pid,
};
use std::os::fd::AsRawFd;

use sm2_lossy_link::{DEVICE, Kind, LossyLink, Namespace, Side, Unavailable, host_address};
use sm2_test_support::{skip, skip_without, until};

use crate::numbered::{LEN_BYTES, assert_changes, datagram, poll_only, profile, receive};

/// How many datagrams are sent each way.
const COUNT: u32 = if cfg!(feature = "slow") {
    10_000
} else {
    3_000
};
/// How many of them are passed to the kernel at a time, as one segmented send.
const TRAIN: u32 = 10;
/// The number of the datagrams that teach the other side an address.
const FIRST: u32 = u32::MAX - 1;
/// The number of the datagrams that follow the others until one of them arrives.
const LAST: u32 = u32::MAX;

/// Makes a link of namespaces. Where that is not possible, reports the reason, and the test has nothing to check.
fn link() -> Option<LossyLink> {
    match LossyLink::namespaces(profile()) {
        Ok(link) => return Some(link),
        Err(Unavailable::Missing(program)) => skip_without(program, "no link of namespaces"),
        Err(reason) => {
            assert!(!has_all_parts(), "{reason}");
            skip(format_args!("no link of namespaces: {reason}"));
        }
    }
    None
}

/// Whether this process may use all parts of a link: then a link has to be possible.
fn has_all_parts() -> bool {
    let script = "ip link add near type veth peer name far && \
                  tc qdisc add dev near root tbf rate 1mbit burst 3028 latency 50ms && nft add table inet t";
    let mut unshare = Command::new("unshare");
    let tried = unshare.args(["--net", "sh", "-c", script]).output();
    tried.is_ok_and(|it| it.status.success())
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
    poll_only(&socket);
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

/// Returns the numbers that arrive while `from` sends all datagrams.
fn carry(from: &UdpSocket, to: &UdpSocket) -> Vec<u32> {
    let mut numbers = Vec::new();
    let is_over = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            send(from);
            until("a last datagram", || {
                from.send(&datagram(LAST)).unwrap();
                thread::sleep(Duration::from_millis(5));
                is_over.load(Ordering::Relaxed)
            });
        });
        until("the last datagram", || match receive(to) {
            Some(LAST) => true,
            None | Some(FIRST) => false,
            Some(number) => {
                numbers.push(number);
                false
            }
        });
        is_over.store(true, Ordering::Relaxed);
    });
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
    let (least, most) = (COUNT as usize / 50, COUNT as usize * 7 / 100);
    assert!(
        (least..=most).contains(&lost),
        "{way}: {lost} of {COUNT} lost"
    );
    // With independent losses, 4 % of the gaps are longer than one. If trains were lost whole, half
    // of them would be.
    assert!(4 * lost < 5 * gaps, "{way}: {lost} lost at {gaps} places");
}

/// Does the work on a thread that stays on one processor, with all threads that the work starts. So datagrams cannot
/// overtake each other in the queues of several processors.
fn on_one_processor(work: impl FnOnce() + Send) {
    let pinned = || {
        let this = Pid::from_raw(0);
        let allowed = sched_getaffinity(this).unwrap();
        let mut processors = 0..CpuSet::count();
        let first = processors.find(|it| allowed.is_set(*it).unwrap()).unwrap();
        let mut one = CpuSet::new();
        one.set(first).unwrap();
        sched_setaffinity(this, &one).unwrap();
        work();
    };
    thread::scope(|scope| scope.spawn(pinned).join().unwrap());
}

#[test]
fn four_percent_are_lost_each_way_one_by_one_and_none_comes_twice_or_late() {
    let Some(link) = link() else {
        return;
    };
    on_one_processor(|| assert_four_percent(link));
}

fn assert_four_percent(mut link: LossyLink) {
    for is_ipv6 in [false, true] {
        let [near, far] = [Side::Near, Side::Far].map(|side| socket(&link, side, is_ipv6));
        near.connect(link.connect(far.local_addr().unwrap()).unwrap())
            .unwrap();
        // The far socket learns the address to answer from the first datagram that arrives.
        let mut from = None;
        until("a first datagram", || {
            near.send(&datagram(FIRST)).unwrap();
            from = far.recv_from(&mut [0; LEN_BYTES]).ok();
            from.is_some()
        });
        far.connect(from.unwrap().1).unwrap();
        let name = if is_ipv6 { "IPv6" } else { "IPv4" };
        for (way, from, to) in [("there", &near, &far), ("back", &far, &near)] {
            assert_lossy(&format!("{name} {way}"), carry(from, to));
        }
    }
}

#[test]
fn a_link_that_is_cut_lets_nothing_through_and_loss_can_be_changed() {
    if let Some(link) = link() {
        assert_changes(link);
    }
}

#[test]
fn a_link_of_namespaces_has_two_hosts_and_the_network_between_them() {
    let Some(link) = link() else {
        return;
    };
    assert_eq!(link.kind(), Kind::Namespaces);
    let of_test = fs::read_link("/proc/self/ns/net").unwrap();
    let read = || fs::read_link("/proc/thread-self/ns/net").unwrap();
    let hosts = [Side::Near, Side::Far].map(|side| link.enter(side, read).unwrap());
    let between = link.between().unwrap();
    let all = [
        &of_test,
        &hosts[0],
        &hosts[1],
        &between.enter(read).unwrap(),
    ];
    assert_eq!(BTreeSet::from(all).len(), 4, "{all:?}");
    for (side, host) in [Side::Near, Side::Far].into_iter().zip(&hosts) {
        assert_eq!(link.host(side).unwrap().enter(read).unwrap(), *host);
        // Another process finds the namespace by its path.
        let path = link.host(side).unwrap().path();
        assert_eq!(fs::read_link(path).unwrap(), *host);
    }
    let [ours, theirs] = [LossyLink::open(profile()), (link, None)].map(|(it, _)| it.kind());
    assert_eq!(ours, theirs, "namespaces are possible here");
}

/// A virtual cable disappears with the namespace of its other end.
#[test]
fn nothing_is_left_of_a_link_that_was_dropped() {
    let Some(mut link) = link() else {
        return;
    };
    // The thread of a relay is in the middle.
    link.connect(SocketAddr::new(host_address(Side::Far, false), 5))
        .unwrap();
    let hosts = [Side::Near, Side::Far].map(|side| link.host(side).unwrap().clone());
    let has_cable = |host: &Namespace| {
        let show = || Command::new("ip").args(["link", "show", DEVICE]).output();
        host.enter(show).unwrap().unwrap().status.success()
    };
    assert!(hosts.iter().all(has_cable));
    drop(link);
    until("the middle is gone", || !hosts.iter().any(has_cable));
}
