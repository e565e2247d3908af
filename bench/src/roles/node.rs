//! Nodes that only are there, daemons, and subscribers that come and go.

use super::Failure;
use crate::{
    clock::now_ns,
    control::{Stage, reached, say},
    job::{Channel, Domain, Outcome, Said},
    peers::{Flow, Handler, Peer, PeerError, Publish, Subscribe, TIMEOUT_NS},
};

/// Longer than any run, in nanoseconds.
const HOURS_NS: u64 = 36_000_000_000_000;

/// Serves until the director ends.
pub(super) fn daemon<P: Peer>(domain: &Domain) -> Result<Outcome, Failure> {
    P::serve(domain, || {
        // A director that is gone is noticed at the end of standard input.
        let _ = say(&Said::Ready);
    })?;
    Ok(Outcome::Nothing)
}

/// Has a channel, and hears its neighbour's; ready when its own neighbour hears it. Ends with the
/// director.
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
    say(&Said::Ready)?;
    subscriber.pump(now_ns() + HOURS_NS)?;
    Ok(Outcome::Nothing)
}

/// Nothing comes.
struct Silent;

impl Handler for Silent {
    fn message(&mut self, _: &[u8]) -> Flow {
        Flow::Continue
    }
}

/// Waits for the first message.
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
            return Err(PeerError::new("join", "no message comes").into());
        }
    }
}

/// When the first message was in hand.
struct First(u64);

impl Handler for First {
    fn message(&mut self, _: &[u8]) -> Flow {
        if self.0 == 0 {
            self.0 = now_ns();
        }
        Flow::Return
    }
}
