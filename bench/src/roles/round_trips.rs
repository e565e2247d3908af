//! Ping and echo: two channels, and one message in flight.

use super::Failure;
use crate::{
    clock::now_ns,
    control::{Stage, reached, send_event, wait_for},
    job::{Channel, Domain, Outcome, ProcessEvent, Read, RoundTrips},
    payload::{Header, check, fill, peek, stamp},
    peers::{Flow, Handler, Peer, PeerError, Publish, Subscribe, TIMEOUT_NS},
    stats::{Durations, Spread},
};

/// The number of round trips before the counted ones.
const WARM_UP: u64 = 100;

/// Timeout of one round trip, in nanoseconds.
const RETURN_NS: u64 = 1_000_000_000;

fn channel(name: &str, trips: &RoundTrips) -> Channel {
    Channel {
        name: name.to_owned(),
        max_len: trips.len,
        depth: 2,
        lossless: true,
        subscribers: 1,
    }
}

/// Reads a message as a subscriber would; returns the header, and whether the message is intact.
fn look(message: &[u8], read: Read) -> (Header, bool) {
    let header = peek(message).unwrap_or_default();
    let whole = match read {
        Read::Full => check(message).is_ok(),
        Read::Header => message.len() >= 32,
    };
    (header, whole)
}

/// Measures round trips. First it measures the whole trip with its own clock alone, then one way
/// with times in the messages.
pub(super) fn ping<P: Peer>(domain: &Domain, trips: &RoundTrips) -> Result<Outcome, Failure> {
    let peer = P::open(domain, "ping", true)?;
    let mut publisher = peer.publisher(&channel("bench/ping", trips))?;
    let pong = Pong {
        read: trips.read,
        expected: 0,
        torn: 0,
        one_way: Durations::default(),
    };
    send_event(&ProcessEvent::Ready)?;
    wait_for(Stage::Go);
    let mut subscriber = peer.subscriber(&channel("bench/pong", trips), pong)?;
    publisher.wait_matched(1)?;
    let mut number = 0;
    let mut trip = |stamped: bool| -> Result<Option<u64>, PeerError> {
        number += 1;
        subscriber.with(|pong| pong.expected = number);
        let sent_ns = now_ns();
        let header = Header {
            number,
            flags: 0,
            start_ns: u64::from(stamped),
            handed_ns: 0,
        };
        publisher.publish(trips.len, |message| fill(header, message))?;
        let until_ns = sent_ns + RETURN_NS;
        loop {
            subscriber.pump(until_ns)?;
            let now = now_ns();
            if subscriber.with(|pong| pong.expected != number) {
                return Ok(Some(now - sent_ns));
            }
            if now >= until_ns {
                return Ok(None);
            }
        }
    };
    let nothing = || PeerError::new("ping", "no message came back");
    let until_ns = now_ns() + TIMEOUT_NS;
    // The echo may not be connected to our subscriber yet.
    while trip(false)?.is_none() {
        if now_ns() > until_ns {
            return Err(nothing().into());
        }
    }
    for _ in 0..WARM_UP {
        trip(false)?.ok_or_else(nothing)?;
    }
    let mut round_trips = Durations::with_capacity(trips.count);
    repeat(trips, || {
        round_trips.record(trip(false)?.ok_or_else(nothing)?);
        Ok(())
    })?;
    repeat(trips, || trip(true)?.map(drop).ok_or_else(nothing))?;
    let (one_way_ns, torn) = subscriber.with(|pong| (pong.spread(), pong.torn));
    Ok(Outcome::RoundTrips {
        round_trip_ns: round_trips.spread(),
        one_way_ns,
        torn,
    })
}

/// Calls `trip` until the count or the time of the job is reached.
pub(super) fn repeat(
    trips: &RoundTrips,
    mut trip: impl FnMut() -> Result<(), PeerError>,
) -> Result<(), PeerError> {
    let end_ns = now_ns() + (trips.seconds * 1e9) as u64;
    for _ in 0..trips.count {
        trip()?;
        if now_ns() >= end_ns {
            break;
        }
    }
    Ok(())
}

/// The handler of the messages that come back to the ping.
struct Pong {
    read: Read,
    /// The number of the expected message; 0 when it has arrived.
    expected: u64,
    torn: u64,
    one_way: Durations,
}

impl Pong {
    fn spread(&self) -> Spread {
        self.one_way.clone().spread()
    }
}

impl Handler for Pong {
    fn wants(&self) -> Read {
        self.read
    }

    fn message(&mut self, message: &[u8]) -> Flow {
        let in_hand_ns = match peek(message) {
            Ok(header) if header.handed_ns != 0 => now_ns(),
            _ => 0,
        };
        let (header, whole) = look(message, self.read);
        self.torn += u64::from(!whole);
        if in_hand_ns != 0 {
            self.one_way
                .record(in_hand_ns.saturating_sub(header.handed_ns));
        }
        if header.number != self.expected {
            return Flow::Continue;
        }
        self.expected = 0;
        Flow::Return
    }
}

/// Answers each message with one of its own, from within the handler.
pub(super) fn echo<P: Peer>(domain: &Domain, trips: &RoundTrips) -> Result<Outcome, Failure>
where
    P::Publisher: 'static,
{
    let peer = P::open(domain, "echo", false)?;
    let publisher = peer.publisher(&channel("bench/pong", trips))?;
    let echo = Echo {
        publisher,
        read: trips.read,
        len: trips.len,
        torn: 0,
        failed: None,
    };
    let mut subscriber = peer.subscriber(&channel("bench/ping", trips), echo)?;
    send_event(&ProcessEvent::Ready)?;
    while !reached(Stage::End) {
        subscriber.pump(now_ns() + 250_000_000)?;
        if let Some(error) = subscriber.with(|echo| echo.failed.take()) {
            return Err(error.into());
        }
    }
    let torn = subscriber.with(|echo| echo.torn);
    Ok(Outcome::RoundTrips {
        round_trip_ns: Spread::default(),
        one_way_ns: Spread::default(),
        torn,
    })
}

struct Echo<P> {
    publisher: P,
    read: Read,
    len: usize,
    torn: u64,
    failed: Option<PeerError>,
}

impl<P: Publish + 'static> Handler for Echo<P> {
    fn wants(&self) -> Read {
        self.read
    }

    fn message(&mut self, message: &[u8]) -> Flow {
        let (header, whole) = look(message, self.read);
        self.torn += u64::from(!whole);
        let stamped = header.start_ns != 0;
        let answer = Header {
            start_ns: 0,
            ..header
        };
        let sent = self.publisher.publish(self.len, |message| {
            fill(answer, message);
            if stamped {
                stamp(message, now_ns());
            }
        });
        match sent {
            Ok(()) => Flow::Continue,
            Err(error) => {
                self.failed = Some(error);
                Flow::Return
            }
        }
    }
}
