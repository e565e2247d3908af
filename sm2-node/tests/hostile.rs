//! Peers that break the protocol: only their link ends.

// Shows DAT-ONCE, DAT-SEALED, DAT-LOCAL, DAT-COST (test), bound: real processes.

use std::fs::File;
use std::io::IoSlice;
use std::os::fd::AsFd;
use std::time::Duration;

use crate::common::raw::{RECEIVER, Raw, attach, pooled, raw_publisher, topic};
use crate::common::{Domain, SOON, meet, pattern, until};
use nix::fcntl::{FcntlArg, SealFlag, fcntl};
use nix::sys::memfd::{MFdFlags, memfd_create};
use sm2_io::fault::{Call, Injector};
use sm2_io::{Listener, RecvError, SeqPacket, wait_readable};
use sm2_node::diagnostics::End;
use sm2_node::domain::DemandedQos;
use sm2_node::{ConnectError, DeclareError, Node, Publisher, Subscriber};
use sm2_proto::{Contract, Seals, ViolationKind, violation};

/// Runs a Manager that welcomes one node, and then sends `answer`. A node that leaves before its first request may try
/// again.
fn manager(answer: &'static [u8]) -> (tempfile::TempDir, std::thread::JoinHandle<SeqPacket>) {
    let folder = tempfile::tempdir().unwrap();
    let listener = Listener::bind(&folder.path().join("test.sock"), 1).unwrap();
    let thread = std::thread::spawn(move || {
        loop {
            assert!(wait_readable(&[listener.as_fd()], Some(SOON)).unwrap());
            let session = listener.accept().unwrap().unwrap();
            if serve(&session, answer) {
                return session;
            }
        }
    });
    (folder, thread)
}

/// Returns whether the node has sent a request.
fn serve(session: &SeqPacket, answer: &[u8]) -> bool {
    for frame in [&WELCOME[..], answer] {
        let mut came = next_frame(session);
        if came.as_ref().is_some_and(|it| it[0] == MAX_LINKS) {
            came = next_frame(session);
        }
        if came.is_none() {
            return false;
        }
        if !frame.is_empty() && session.send(&[IoSlice::new(frame)], &[]).is_err() {
            return false;
        }
    }
    true
}

/// Waits for the next frame of the node; `None` at the end of the connection.
fn next_frame(session: &SeqPacket) -> Option<Vec<u8>> {
    let mut buffer = vec![0; 65_536];
    assert!(wait_readable(&[session.as_fd()], Some(SOON)).unwrap());
    match session.recv(&mut buffer) {
        Ok(received) => Some(buffer[..received.len].to_vec()),
        Err(RecvError::Closed) => None,
        Err(error) => panic!("{error}"),
    }
}

/// The number of the frame that follows WELCOME.
const MAX_LINKS: u8 = 13;

/// Frame 0, version 1, epoch 1, node 1.
const WELCOME: [u8; 4] = [0, 1, 1, 1];

fn connect(folder: &tempfile::TempDir, timeout: Duration) -> Result<Node, ConnectError> {
    let builder = Node::builder("node").socket(folder.path().join("test.sock"));
    builder.manager_timeout(timeout).connect()
}

/// Connects to a Manager that answers the first declaration with `answer`. Returns the error of the declaration, unless
/// the Manager was slower than `timeout`.
fn left(answer: &'static [u8], timeout: Duration) -> Option<(Node, SeqPacket, DeclareError)> {
    let (folder, manager) = manager(answer);
    let node = connect(&folder, timeout).ok()?;
    let error = node.publisher::<[u8]>("topic").unwrap_err();
    let in_time = !matches!(error, DeclareError::TimedOut { .. });
    in_time.then(|| (node, manager.join().unwrap(), error))
}

//= SM2-NOD-001 test
#[test]
fn a_manager_that_breaks_the_protocol_is_left() {
    // WITHDRAWN for an interface that was never declared. No other Manager comes for the node.
    let mut timeout = Duration::from_millis(200);
    let (node, session, error) = loop {
        match left(&[6, 9], timeout) {
            Some(left) => break left,
            None if timeout > SOON => panic!("the node does not notice it"),
            None => timeout *= 2,
        }
    };
    let text = error.to_string();
    assert!(matches!(error, DeclareError::ManagerGone { .. }));
    assert!(text.contains("unknown-interface"), "{text}");
    assert!(!node.is_connected());
    assert_eq!(next_frame(&session).unwrap(), [9], "COUNTERS");
    let goodbye = next_frame(&session).unwrap();
    assert_eq!(goodbye, [5, 36], "GOODBYE unknown-interface");
    assert_eq!(next_frame(&session), None);
}

#[test]
fn a_manager_that_does_not_answer_is_not_waited_for_for_ever() {
    let (folder, manager) = manager(&[]);
    // On a busy machine, this Manager may be too slow to welcome the node, too.
    let mut node = None;
    until(|| {
        node = connect(&folder, Duration::from_millis(200)).ok();
        node.is_some()
    });
    let node = node.unwrap();
    let error = node.publisher::<[u8]>("topic").unwrap_err();
    assert!(matches!(error, DeclareError::TimedOut { .. }), "{error}");
    // The Manager was slow, not dead: a declaration that it grants too late is withdrawn.
    let session = manager.join().unwrap();
    session.send(&[IoSlice::new(&[2, 1, 0])], &[]).unwrap();
    assert_eq!(next_frame(&session).unwrap(), [9], "COUNTERS");
    until(|| {
        node.spin_some().unwrap();
        wait_readable(&[session.as_fd()], Some(Duration::ZERO)).unwrap()
    });
    assert_eq!(next_frame(&session).unwrap(), [2, 1], "WITHDRAW");
}

/// A publisher and a correct subscriber, which the hostile peer must not affect.
fn honest(domain: &Domain) -> (Publisher<[u8]>, Subscriber<[u8]>) {
    let publisher = domain.node("talker").publisher::<[u8]>("topic").unwrap();
    let subscriber = domain.node("listener").subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&subscriber]);
    (publisher, subscriber)
}

//= SM2-OPN-008 test
#[test]
fn a_subscriber_that_breaks_the_protocol_loses_its_link_alone() {
    let domain = Domain::new();
    let (publisher, subscriber) = honest(&domain);
    let contract = Contract::Subscriber {
        topic: topic(),
        data: None,
        demand: DemandedQos::new(2, 1),
    };
    let raw = Raw::declare(&domain, "raw", &contract);
    raw.open(RECEIVER, 3);
    publisher.wait_for_subscribers_timeout(2, SOON).unwrap();
    publisher.publish(&pattern(5000, 0)).unwrap();
    // Releases a message that it never received.
    let mut release = vec![7, 0, 1, 0, 0, 0, 0, 0];
    release.extend(99_u64.to_le_bytes());
    raw.send(&release, &[]);
    let code = raw.closed(|| drop(publisher.links()));
    assert_eq!(code, ViolationKind::BadRelease.code().0);
    let links = publisher.links();
    let ended = &links[0];
    assert_eq!(
        ended.end,
        Some(End::Violation(violation!(BadRelease, "SM2-MSG-004")))
    );
    assert_eq!(ended.peer.name.as_str(), "raw");
    assert_eq!((ended.counters.offered, ended.counters.closed), (1, 1));
    assert_eq!(publisher.counters().offered, 2);
    for seed in 1..20 {
        publisher.publish(&pattern(5000, seed)).unwrap();
        let expected = pattern(5000, seed - 1);
        assert!(*subscriber.recv_timeout(SOON).unwrap().unwrap() == *expected);
    }
    assert!(
        publisher
            .wait_for_subscribers_timeout(2, Duration::from_millis(5))
            .is_err()
    );
}

/// A file of zeroes without memory, with the seals of a sealed message.
fn hole(len: u64) -> File {
    let flags = MFdFlags::MFD_CLOEXEC | MFdFlags::MFD_ALLOW_SEALING;
    let file = File::from(memfd_create(c"hole", flags).unwrap());
    file.set_len(len).unwrap();
    let seals = SealFlag::from_bits_retain(Seals::SEALED.0.cast_signed());
    fcntl(&file, FcntlArg::F_ADD_SEALS(seals)).unwrap();
    file
}

fn inline(sequence: u64, payload: &[u8]) -> Vec<u8> {
    let mut frame = vec![4, 0, 0, 0];
    frame.extend([0; 12]);
    for word in [sequence, sequence, 0, payload.len() as u64] {
        frame.extend(word.to_le_bytes());
    }
    frame.extend(payload);
    frame
}

fn sealed(sequence: u64, len: u64) -> Vec<u8> {
    let mut frame = vec![4, 2, 0, 0];
    frame.extend([0; 12]);
    for word in [sequence, sequence, 0, len] {
        frame.extend(word.to_le_bytes());
    }
    frame
}

/// A subscriber with the default maximum takes a message of exactly 1 GiB, and does not map a file of 6 GiB.
//= SM2-PAY-010 test
#[test]
fn a_message_that_is_too_long_is_refused_before_it_is_mapped() {
    let domain = Domain::new();
    let (raw, subscriber) = raw_publisher(&domain);
    // The first datagram that a thread reads makes it map its buffer.
    raw.send(&inline(1, b"first"), &[]);
    assert_eq!(*subscriber.recv_timeout(SOON).unwrap().unwrap(), *b"first");
    let calls = Injector::counting();
    let _installed = calls.install();
    let mappings = || calls.counts().get(&Call::Mmap).copied().unwrap_or(0);
    let before = mappings();
    let file = hole(1 << 30);
    raw.send(&sealed(2, 1 << 30), &[file.as_fd()]);
    let sample = subscriber.recv_timeout(SOON).unwrap().unwrap();
    assert!(
        sample.len() == 1 << 30 && mappings() > before,
        "it is mapped"
    );
    drop(sample);

    let before = mappings();
    let file = hole(6 << 30);
    raw.send(&sealed(3, 6 << 30), &[file.as_fd()]);
    let code = raw.closed(|| assert!(subscriber.try_recv().unwrap().is_none()));
    assert_eq!(code, ViolationKind::MessageTooLong.code().0);
    assert_eq!(mappings(), before);
    let end = End::Violation(violation!(MessageTooLong, "SM2-PAY-010"));
    assert_eq!(subscriber.links()[0].end, Some(end));
}

//= SM2-SEG-001 test
#[test]
fn what_is_no_sealed_memory_is_never_mapped() {
    let domain = Domain::new();
    let (raw, subscriber) = raw_publisher(&domain);
    let file = File::open("/dev/zero").unwrap();
    raw.send(&attach(1, 4096, 1), &[file.as_fd()]);
    let code = raw.closed(|| drop(subscriber.try_recv().unwrap()));
    assert_eq!(code, ViolationKind::NotAMemfd.code().0);
    let end = End::Violation(violation!(NotAMemfd, "SM2-SEG-001"));
    assert_eq!(subscriber.links()[0].end, Some(end));
}

/// A segment whose slot begins with a frame header. The receiver uses the length and the offset of the
/// datagram, whatever the shared memory contains.
//= SM2-PAY-006 test
//= SM2-PAY-003 test
#[test]
fn lengths_and_places_come_from_the_datagram() {
    let domain = Domain::new();
    let (raw, subscriber) = raw_publisher(&domain);
    let (fd, mut slots) = sm2_io::Segment::create(4096, 2).unwrap().split();
    let lie = pooled(1, 0, 1, 1 << 30);
    slots[1].bytes_mut(lie.len()).copy_from_slice(&lie);
    raw.send(&attach(1, 4096, 2), &[fd.as_fd()]);
    raw.send(&pooled(1, 1, 1, 20), &[]);
    let sample = subscriber.recv_timeout(SOON).unwrap().unwrap();
    assert_eq!(*sample, lie[..20]);
    // The slot is overwritten while the subscriber holds it. Length and offset stay, and only these bytes can
    // change.
    slots[1].bytes_mut(4096).fill(0xff);
    assert_eq!(*sample, [0xff; 20]);
    drop(sample);
    raw.send(&pooled(1, 1, 2, 4097), &[]);
    let code = raw.closed(|| drop(subscriber.try_recv().unwrap()));
    assert_eq!(code, ViolationKind::BadLength.code().0);
}

//= SM2-PAY-007 test
#[test]
fn a_receiver_cannot_write_what_it_maps() {
    let domain = Domain::new();
    let (raw, subscriber) = raw_publisher(&domain);
    // A size that no segment of another test has.
    let (stride, slots) = (4096 * 77, 3);
    let (fd, _slots) = sm2_io::Segment::create(stride, slots).unwrap().split();
    raw.send(&attach(1, stride, slots), &[fd.as_fd()]);
    raw.send(&pooled(1, 0, 1, 100), &[]);
    let sample = subscriber.recv_timeout(SOON).unwrap().unwrap();
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let mut rights: Vec<_> = maps
        .lines()
        .filter(|line| line.contains("memfd:sm2-segment"))
        .filter_map(|line| {
            let (range, rest) = line.split_once(' ')?;
            let (start, end) = range.split_once('-')?;
            let address = |hex| u64::from_str_radix(hex, 16).ok();
            let size = address(end)? - address(start)?;
            (size == stride * u64::from(slots)).then_some(&rest[..4])
        })
        .collect();
    rights.sort_unstable();
    // The mapping of the author, which is in this process too, and that of the receiver.
    assert_eq!(rights, ["r--s", "rw-s"]);
    drop(sample);
}
