//! The client and the server of a service.

use super::{Failure, round_trips::repeat};
use crate::{
    clock::now_ns,
    control::{Stage, send_event, wait_for},
    job::{Channel, Domain, Outcome, ProcessEvent, RoundTrips},
    payload::{Header, check, fill, peek},
    peers::{Call, Peer},
    stats::{Durations, Spread},
};

/// The number of calls before the counted ones.
const WARM_UP: u64 = 100;

fn channel(trips: &RoundTrips) -> Channel {
    Channel {
        name: "bench/service".to_owned(),
        max_len: trips.len,
        depth: 2,
        lossless: true,
        subscribers: 1,
    }
}

/// Calls the service, one call after the other.
pub(super) fn call<P: Peer>(domain: &Domain, trips: &RoundTrips) -> Result<Outcome, Failure> {
    let peer = P::open(domain, "client", false)?;
    let channel = channel(trips);
    let mut client = peer.client(&channel)?;
    send_event(&ProcessEvent::Ready)?;
    wait_for(Stage::Go);
    let (mut number, mut torn) = (0, 0);
    let mut round_trips = Durations::with_capacity(trips.count);
    let mut exchange = || {
        number += 1;
        let start_ns = now_ns();
        let header = Header {
            number,
            ..Header::default()
        };
        client.call(
            trips.len,
            |request| fill(header, request),
            |reply| {
                let right = check(reply).is_ok_and(|header| header.number == number);
                torn += u64::from(!right);
            },
        )?;
        round_trips.record(now_ns() - start_ns);
        if number == WARM_UP {
            round_trips.clear();
        }
        Ok(())
    };
    for _ in 0..WARM_UP {
        exchange()?;
    }
    repeat(trips, exchange)?;
    Ok(Outcome::RoundTrips {
        round_trip_ns: round_trips.spread(),
        one_way_ns: Spread::default(),
        torn,
    })
}

/// Replies with the number of the request; to a torn request, with number 0.
pub(super) fn serve<P: Peer>(domain: &Domain, trips: &RoundTrips) -> Result<Outcome, Failure> {
    let peer = P::open(domain, "server", true)?;
    let answer = |request: &[u8], reply: &mut [u8]| {
        let header = match check(request) {
            Ok(_) => peek(request).unwrap_or_default(),
            Err(_) => Header::default(),
        };
        fill(header, reply);
    };
    let ready = || {
        // If the director is gone, standard input has ended, which ends this process.
        let _ = send_event(&ProcessEvent::Ready);
    };
    peer.answer(&channel(trips), answer, ready)?;
    Ok(Outcome::Nothing)
}
