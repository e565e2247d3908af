//! A subscriber that does not read its socket for a while, so that packets wait for the socket.

use std::io::IoSlice;
use std::time::Duration;

use crate::common::{Domain, SOON, meet, pattern};
use sm2_io::SeqPacket;

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
            publisher.publish(&pattern(100, 0)).unwrap();
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
