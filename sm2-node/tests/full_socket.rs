//! A subscriber that does not read its socket for a while, so that packets wait for the socket.

use std::io::IoSlice;
use std::time::Duration;

use crate::common::{Domain, SOON, meet, pattern, until};
use nix::libc::ENOMEM;
use sm2_io::SeqPacket;
use sm2_io::fault::{Call, Fault, Injector};

/// How many short datagrams a socket accepts before it is full.
fn datagrams_until_full() -> usize {
    let (one, _other) = SeqPacket::pair().unwrap();
    let is_sent = || one.send(&[IoSlice::new(&[0; 24])], &[]).is_ok();
    std::iter::repeat_with(is_sent).take_while(|it| *it).count()
}

/// On the ring lane, the socket carries little more than ATTACH and DETACH. Each message here needs a new
/// segment, and the segment of the last message but one goes back to the system. The packet that fills the socket is
/// an ATTACH in one of two runs. Its segment goes back to the system while the ATTACH waits.
//= SM2-RNG-009, SM2-SEG-005 test
#[test]
fn a_segment_that_is_freed_while_its_attach_waits_does_not_end_the_link() {
    for first in [1, 2] {
        let domain = Domain::new();
        let builder = domain
            .node_on(true, "talker")
            .publisher_builder::<[u8]>("topic");
        let publisher = builder.keep_idle(Duration::ZERO).declare().unwrap();
        let subscriber = domain
            .node_on(true, "listener")
            .subscriber_builder::<[u8]>("topic");
        let subscriber = subscriber.depth(1).declare().unwrap();
        meet(&publisher, &[&subscriber]);
        // Fills the socket with pairs of ATTACH and DETACH, after one datagram or two.
        for _ in 0..first {
            publisher.publish(&pattern(128, 0)).unwrap();
        }
        for seed in 0..datagrams_until_full() as u64 {
            let len = [3_000, 12_000, 48_000][seed as usize % 3];
            publisher.publish(&pattern(len, seed)).unwrap();
        }
        while subscriber.try_recv().unwrap().is_some() {}
        assert!(subscriber.links()[0].open);
        let links = publisher.links();
        assert!(links[0].open, "{:?}", links[0].end);
        publisher.publish(b"last").unwrap();
        let last = subscriber.recv_timeout(SOON).unwrap().unwrap();
        assert_eq!(*last, *b"last");
    }
}

/// The newest message needs a segment, and its ATTACH waits for the socket. It takes the place of the one that waited
/// before, and reaches the subscriber although no further message is published.
//= SM2-QOS-001, SM2-RNG-009 test
#[test]
fn the_newest_message_waits_for_the_attach_of_its_segment() {
    let domain = Domain::new();
    let node = |name| {
        let builder = domain.builder(name).ring_lane(true).background(false);
        builder.connect().unwrap()
    };
    let builder = node("talker").publisher_builder::<[u8]>("topic");
    let publisher = builder.keep_idle(Duration::ZERO).declare().unwrap();
    let builder = node("listener").subscriber_builder::<[u8]>("topic");
    let subscriber = builder.depth(1).declare().unwrap();
    meet(&publisher, &[&subscriber]);
    let mut published = 0;
    // Each message needs another segment than the one before, until the socket accepts no further ATTACH.
    while publisher.links()[0].counters.overwritten < 3 {
        published += 1;
        let len = [3_000, 12_000, 48_000][published as usize % 3];
        publisher.publish(&pattern(len, published)).unwrap();
        assert!(published < 10 * datagrams_until_full() as u64);
    }
    let mut last = 0;
    until(|| {
        // Drives the node of the publisher.
        publisher.links();
        while let Some(sample) = subscriber.try_recv().unwrap() {
            last = sample.sequence();
            assert!(*sample == *pattern(sample.len(), last), "{last}");
        }
        last == published
    });
    let counters = publisher.counters();
    assert_eq!(counters.offered, published, "{counters:?}");
    assert!(publisher.links()[0].open && subscriber.links()[0].open);
}

/// A latched message whose ATTACH waits is not overtaken by a publication that needs none: ids ascend on a link.
//= SM2-QOS-005, SM2-MSG-002 test
#[test]
fn a_publication_does_not_overtake_a_latched_message_that_waits() {
    // The first packet that finds no memory: one of them is the ATTACH of the second message.
    for nth in 1..=6 {
        let domain = Domain::new();
        let node = |name, background| {
            let builder = domain.builder(name).ring_lane(true);
            builder.background(background).connect().unwrap()
        };
        let builder = node("talker", false).publisher_builder::<[u8]>("topic");
        let publisher = builder.latched(2).declare().unwrap();
        publisher.publish(&pattern(100, 1)).unwrap();
        publisher.publish(&pattern(48_000, 2)).unwrap();
        let listener = node("listener", true);
        let subscriber = listener.subscriber_builder::<[u8]>("topic").depth(8);
        let subscriber = subscriber.declare().unwrap();
        let faults = Injector::new(Fault {
            call: Call::SendMsg,
            nth,
            times: u64::MAX,
            errno: ENOMEM,
        });
        let installed = faults.install();
        until(|| publisher.links().iter().any(|it| it.open) || faults.hits() > 0);
        publisher.publish(&pattern(100, 3)).unwrap();
        drop(installed);
        let mut taken = Vec::new();
        until(|| {
            // Drives the node of the publisher.
            let links = publisher.links();
            assert!(links.iter().all(|it| it.end.is_none()), "packet {nth}");
            while let Some(sample) = subscriber.try_recv().unwrap() {
                assert!(*sample == *pattern(sample.len(), sample.sequence()));
                taken.push(sample.sequence());
            }
            taken.last() == Some(&3)
        });
        assert!(taken.is_sorted(), "packet {nth}: {taken:?}");
    }
}
