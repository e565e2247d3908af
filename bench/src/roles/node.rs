//! Daemons, idle nodes, and subscribers that exit after their first message.

use super::Failure;
use crate::{
    clock::now_ns,
    control::{Stage, reached, send_event},
    job::{Channel, Domain, Outcome, ProcessEvent},
    peers::{Flow, Handler, Peer, PeerError, Publish, Subscribe, TIMEOUT_NS},
};

/// Longer than any run, in nanoseconds.
const HOURS_NS: u64 = 36_000_000_000_000;

/// Serves until the director ends.
pub(super) fn daemon<P: Peer>(domain: &Domain) -> Result<Outcome, Failure> {
    P::serve(domain, || {
        // If the director is gone, standard input has ended, which ends this process.
        let _ = send_event(&ProcessEvent::Ready);
    })?;
    Ok(Outcome::Nothing)
}

/// Publishes on a channel of its own, and subscribes to the channel of the next node. Ready when the
/// previous node has subscribed to its channel. Ends with the director.
pub(super) fn node<P: Peer>(
    domain: &Domain,
    number: usize,
    count: usize,
) -> Result<Outcome, Failure> {
    let channel = |number: usize| Channel {
        name: format!("bench/node{number}"),
        max_len: 64,
        depth: 8,
        lossless: false,
        subscribers: 1,
    };
    let peer = P::open(domain, &format!("node-{number}"), number == 0)?;
    let mut publisher = peer.publisher(&channel(number))?;
    let mut subscriber = peer.subscriber(&channel((number + 1) % count), Silent)?;
    publisher.wait_matched(1)?;
    send_event(&ProcessEvent::Ready)?;
    subscriber.pump(now_ns() + HOURS_NS)?;
    Ok(Outcome::Nothing)
}

/// A handler for channels without messages.
struct Silent;

impl Handler for Silent {
    fn message(&mut self, _: &[u8]) -> Flow {
        Flow::Continue
    }
}

/// Waits for the first message, and reports the time since the start of the process.
pub(super) fn join<P: Peer>(
    domain: &Domain,
    channel: &Channel,
    started_ns: u64,
) -> Result<Outcome, Failure> {
    let name = format!("joiner-{started_ns}");
    let peer = P::open(domain, &name, false)?;
    let mut subscriber = peer.subscriber(channel, First(0))?;
    let until_ns = now_ns() + TIMEOUT_NS;
    loop {
        subscriber.pump(until_ns)?;
        let first_ns = subscriber.with(|first| first.0);
        if first_ns != 0 {
            let after_ns = first_ns.saturating_sub(started_ns);
            return Ok(Outcome::Joined { after_ns });
        }
        if now_ns() >= until_ns || reached(Stage::End) {
            return Err(PeerError::new("join", "no message arrived").into());
        }
    }
}

/// The time when the first message arrived; 0 before.
struct First(u64);

impl Handler for First {
    fn message(&mut self, _: &[u8]) -> Flow {
        if self.0 == 0 {
            self.0 = now_ns();
        }
        Flow::Return
    }
}
