//! Numbered datagrams over an emulated link, and the account of what becomes of them.

use std::{
    net::{SocketAddr, UdpSocket},
    time::Duration,
};

use sm2_lossy_link::{LossyLink, Profile, Side};
use sm2_test_support::until;

pub(crate) const LEN_BYTES: usize = 100;
/// How many datagrams a round has.
const ROUND: u32 = 100;

/// The paper's Wi-Fi without its pauses.
pub(crate) fn profile() -> Profile {
    Profile {
        pauses: Vec::new(),
        ..Profile::wifi()
    }
}

pub(crate) fn datagram(number: u32) -> Vec<u8> {
    let mut bytes = number.to_le_bytes().to_vec();
    bytes.resize(LEN_BYTES, number as u8);
    bytes
}

/// Lets [`receive`] return after a moment when nothing arrives.
pub(crate) fn poll_only(socket: &UdpSocket) {
    let moment = Some(Duration::from_millis(10));
    socket.set_read_timeout(moment).unwrap();
}

/// Returns the number of the next datagram; `None` if none is there.
pub(crate) fn receive(socket: &UdpSocket) -> Option<u32> {
    let mut buffer = [0; 2_048];
    let len = socket.recv(&mut buffer).ok()?;
    let number = u32::from_le_bytes(*buffer.first_chunk().unwrap());
    assert_eq!(&buffer[..len], datagram(number), "damaged");
    Some(number)
}

/// Two sockets with a link between them.
struct Pair {
    link: LossyLink,
    near: UdpSocket,
    far: UdpSocket,
    /// The number of the first datagram of the next round.
    next: u32,
}

impl Pair {
    fn new(mut link: LossyLink) -> Self {
        let bind = |side, address: SocketAddr| link.enter(side, || UdpSocket::bind(address));
        let [near, far] =
            [Side::Near, Side::Far].map(|side| bind(side, link.listen()).unwrap().unwrap());
        near.connect(link.connect(far.local_addr().unwrap()).unwrap())
            .unwrap();
        poll_only(&far);
        Self {
            link,
            near,
            far,
            next: 0,
        }
    }

    /// Sends a round. Returns how many of its datagrams arrive, once each has arrived or is lost. No datagram of an
    /// earlier round arrives.
    fn arrived(&mut self) -> u32 {
        let round = self.next..self.next + ROUND;
        self.next = round.end;
        let lost_before = self.link.lost().unwrap();
        for number in round.clone() {
            self.near.send(&datagram(number)).unwrap();
        }
        let mut arrived = 0;
        until("each datagram has arrived or is lost", || {
            while let Some(number) = receive(&self.far) {
                assert!(round.contains(&number), "{number} in {round:?}");
                arrived += 1;
            }
            let lost = self.link.lost().unwrap() - lost_before;
            u64::from(arrived) + lost >= round.len() as u64
        });
        arrived
    }
}

/// Asserts that a link loses as many datagrams as it was last told.
pub(crate) fn assert_changes(link: LossyLink) {
    let kind = link.kind().as_str();
    let mut pair = Pair::new(link);
    pair.link.set_loss(0.0).unwrap();
    assert_eq!(pair.arrived(), ROUND, "{kind}");
    pair.link.set_loss(50.0).unwrap();
    assert!((10..=90).contains(&pair.arrived()), "{kind}");
    // The loss is a part of all datagrams, and no more.
    for (percent, arrived) in [(100.0, 0), (-1.0, ROUND), (200.0, 0)] {
        pair.link.set_loss(percent).unwrap();
        assert_eq!(pair.arrived(), arrived, "{kind}: {percent} %");
    }
    pair.link.cut().unwrap();
    assert_eq!(pair.arrived(), 0, "{kind}");
    pair.link.set_loss(0.0).unwrap();
    assert_eq!(pair.arrived(), 0, "{kind}: cut means cut");
    pair.link.restore().unwrap();
    assert_eq!(pair.arrived(), ROUND, "{kind}");
}
