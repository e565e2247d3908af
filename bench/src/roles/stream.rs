//! The publisher and the subscribers of a stream.

use super::{Failure, reception::ReceptionCounter};
use crate::{
    clock::{now_ns, sleep_until},
    control::{Stage, reached, send_event, wait_for},
    job::{Channel, Domain, Outcome, ProcessEvent, Read, Stream},
    payload::{COUNTED, Header, fill, stamp},
    peers::{Peer, PeerError, Publish, Subscribe},
};

/// The time between two checks of a subscriber whether to end, in nanoseconds. It is longer than the
/// time between two messages, so that the checks cost nothing.
const LOOK_NS: u64 = 250_000_000;

/// The number of unstamped messages between two readings of the clock.
const RUN: usize = 64;

/// Publishes from `go` to `stop`. Messages between the warm-up and the end of the counted part are
/// counted.
pub(super) fn publish<P: Peer>(domain: &Domain, stream: &Stream) -> Result<Outcome, Failure> {
    let peer = P::open(domain, "publisher", true)?;
    let publisher = peer.publisher(&stream.channel)?;
    send_event(&ProcessEvent::Ready)?;
    wait_for(Stage::Go);
    let mut source = Source {
        publisher,
        stream,
        number: 0,
    };
    source.publisher.wait_matched(stream.channel.subscribers)?;
    source.run(stream.warm_up_s, 0)?;
    send_event(&ProcessEvent::Measuring)?;
    let start_ns = now_ns();
    let counted = source.run(stream.seconds, COUNTED)?;
    let seconds = (now_ns() - start_ns) as f64 / 1e9;
    send_event(&ProcessEvent::Measured)?;
    // The director now measures the memory of all processes while messages flow.
    while !reached(Stage::Stop) {
        source.run(0.05, 0)?;
    }
    source.publisher.flush()?;
    // Subscribers read from this process' memory until the director ends it.
    send_event(&ProcessEvent::Done(Outcome::Published { counted, seconds }))?;
    wait_for(Stage::End);
    Ok(Outcome::Nothing)
}

struct Source<'a, P> {
    publisher: P,
    stream: &'a Stream,
    number: u64,
}

impl<P: Publish> Source<'_, P> {
    /// Publishes for this many seconds, and returns the number of messages.
    ///
    /// Each message is due at a fixed time after the first one, so that one late message does not
    /// delay the others. A publisher that cannot keep up publishes fewer messages in the same time.
    /// With a rate, `stop` ends the stream at once.
    fn run(&mut self, seconds: f64, flags: u64) -> Result<u64, PeerError> {
        let start_ns = now_ns();
        let end_ns = start_ns + (seconds * 1e9) as u64;
        let mut count = 0;
        loop {
            match self.stream.rate_hz {
                Some(rate) => {
                    let due_ns = start_ns + (count as f64 * 1e9 / rate) as u64;
                    if reached(Stage::Stop) {
                        return Ok(count);
                    }
                    if due_ns >= end_ns || now_ns() >= end_ns {
                        sleep_until(end_ns.min(due_ns));
                        return Ok(count);
                    }
                    sleep_until(due_ns);
                }
                None if now_ns() >= end_ns => return Ok(count),
                None => {}
            }
            let run = match (self.stream.rate_hz, self.stream.stamped) {
                (None, false) => RUN,
                _ => 1,
            };
            self.publish(run, flags)?;
            count += run as u64;
        }
    }

    fn publish(&mut self, run: usize, flags: u64) -> Result<(), PeerError> {
        let (stamped, number) = (self.stream.stamped, &mut self.number);
        let write = |message: &mut [u8]| {
            let header = Header {
                number: *number,
                flags,
                start_ns: if stamped { now_ns() } else { 0 },
                handed_ns: 0,
            };
            *number += 1;
            fill(header, message);
            if stamped {
                stamp(message, now_ns());
            }
        };
        match run {
            1 => self.publisher.publish(self.stream.len, write),
            _ => self.publisher.publish_run(run, self.stream.len, write),
        }
    }
}

/// Receives until standard input ends.
pub(super) fn subscribe<P: Peer>(
    domain: &Domain,
    channel: &Channel,
    read: Read,
    number: usize,
) -> Result<Outcome, Failure> {
    let peer = P::open(domain, &format!("subscriber-{number}"), false)?;
    let mut subscriber = peer.subscriber(channel, ReceptionCounter::new(read))?;
    send_event(&ProcessEvent::Ready)?;
    while !reached(Stage::End) {
        subscriber.pump(now_ns() + LOOK_NS)?;
    }
    Ok(Outcome::Received(
        subscriber.with(|counter| counter.reception()),
    ))
}
