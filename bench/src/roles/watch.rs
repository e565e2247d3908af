//! A subscriber that records the arrival of each message, for workloads that measure parts of a
//! stream.

use super::Failure;
use crate::{
    clock::now_ns,
    control::{Stage, reached, send_event},
    job::{Arrival, Channel, Domain, Outcome, ProcessEvent, Read, Watch},
    payload::{check, peek},
    peers::{Flow, Handler, Peer, Subscribe},
};

/// The time between two checks of a watcher whether to end, in nanoseconds.
const LOOK_NS: u64 = 250_000_000;

/// Receives until standard input ends.
pub(super) fn watch<P: Peer>(
    domain: &Domain,
    channel: &Channel,
    read: Read,
    number: usize,
) -> Result<Outcome, Failure> {
    let peer = P::open(domain, &format!("watcher-{number}"), false)?;
    let watch = Watch::default();
    let mut subscriber = peer.subscriber(channel, Watcher { read, watch })?;
    send_event(&ProcessEvent::Ready)?;
    while !reached(Stage::End) {
        subscriber.pump(now_ns() + LOOK_NS)?;
    }
    Ok(Outcome::Watched(
        subscriber.with(|watcher| std::mem::take(&mut watcher.watch)),
    ))
}

struct Watcher {
    read: Read,
    watch: Watch,
}

impl Handler for Watcher {
    fn wants(&self) -> Read {
        self.read
    }

    fn message(&mut self, message: &[u8]) -> Flow {
        let in_hand_ns = now_ns();
        let header = match self.read {
            Read::Full => check(message),
            Read::Header => peek(message),
        };
        match header {
            Ok(header) => self.watch.arrivals.push(Arrival {
                number: header.number,
                start_ns: header.start_ns,
                handed_ns: header.handed_ns,
                in_hand_ns,
                read_ns: now_ns(),
            }),
            Err(_) => self.watch.torn += 1,
        }
        // Return after each message: the caller checks whether standard input has ended.
        Flow::Return
    }
}

#[cfg(test)]
mod tests {
    use super::{Watch, Watcher};
    use crate::{
        job::Read,
        payload::{Header, fill},
        peers::Handler,
    };

    #[test]
    fn whole_messages_are_noted_and_others_counted() {
        let mut watcher = Watcher {
            read: Read::Full,
            watch: Watch::default(),
        };
        let mut message = vec![0; 128];
        let header = Header {
            number: 7,
            start_ns: 1,
            handed_ns: 2,
            ..Header::default()
        };
        fill(header, &mut message);
        watcher.message(&message);
        message[100] ^= 1;
        watcher.message(&message);
        watcher.message(&[0; 7]);
        let [arrival] = watcher.watch.arrivals[..] else {
            panic!("{:?}", watcher.watch);
        };
        assert_eq!((arrival.number, watcher.watch.torn), (7, 2));
        assert!(arrival.handed_ns < arrival.in_hand_ns);
        assert!(arrival.in_hand_ns <= arrival.read_ns);
    }
}
