//! Round trips of one message, for several lengths.

use std::time::Duration;

use super::{
    Case, Figure, Options, figure,
    stream::{Setting, memory_alone},
};
use crate::{
    job::{Outcome, Read, Role, RoundTrips},
    peers::PeerInfo,
    world::{Failure, TIMEOUT, World},
};

/// The lengths of messages, in bytes.
const LENGTHS: [usize; 5] = [64, 1_024, 16_384, 131_072, 1_048_576];

pub(super) fn cases(options: &Options) -> Vec<Box<dyn Case>> {
    LENGTHS
        .map(|len| {
            Box::new(PingPong(RoundTrips {
                len,
                read: options.read,
                count: 20_000,
                seconds: options.seconds.unwrap_or(1.0) / 2.0,
            })) as Box<dyn Case>
        })
        .into()
}

struct PingPong(RoundTrips);

impl Case for PingPong {
    fn label(&self) -> String {
        format!("{}B", self.0.len)
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        if peer.name == "raw-memcpy" {
            return self.memory(peer);
        }
        let mut world = World::new(peer)?;
        let ping = world.start("ping", Role::Ping(self.0.clone()))?;
        world.ready(ping)?;
        let echo = world.start("echo", Role::Echo(self.0.clone()))?;
        world.ready(echo)?;
        world.send_word(ping, "go");
        let limit = TIMEOUT + Duration::from_secs_f64(2.0 * self.0.seconds);
        let pinged = world.outcome(ping, limit)?;
        world.end(echo);
        let echoed = world.outcome(echo, TIMEOUT)?;
        Ok(figures(&pinged, &echoed))
    }
}

fn figures(pinged: &Outcome, echoed: &Outcome) -> Vec<Figure> {
    let Outcome::RoundTrips {
        round_trip_ns,
        one_way_ns,
        torn,
    } = pinged
    else {
        return Vec::new();
    };
    let torn_there = match echoed {
        Outcome::RoundTrips { torn, .. } => *torn,
        _ => 0,
    };
    vec![
        figure("half_round_trip_p50", "us", round_trip_ns.p50 / 2e3),
        figure("half_round_trip_mean", "us", round_trip_ns.mean / 2e3),
        figure("half_round_trip_p99", "us", round_trip_ns.p99 / 2e3),
        figure("one_way_by_stamp_p50", "us", one_way_ns.p50 / 1e3),
        figure("torn", "messages", (torn + torn_there) as f64),
    ]
}

impl PingPong {
    fn memory(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        // A ping and its echo never work at the same time: one subscriber, and `memory_alone`
        // uses the time of one write and one read.
        let setting = Setting {
            len: self.0.len,
            subscribers: 1,
            rate_hz: None,
            seconds: self.0.seconds,
            read: self.0.read,
            depth: 1,
            lossless: true,
            stamped: false,
        };
        let (_, one_way) = memory_alone(peer, &setting)?;
        Ok(vec![
            figure("half_round_trip_p50", "us", one_way.p50 / 1e3),
            figure("half_round_trip_mean", "us", one_way.mean / 1e3),
        ])
    }
}

/// Round trips of 64 bytes, for services.
pub(super) const fn short(read: Read, seconds: f64) -> RoundTrips {
    RoundTrips {
        len: 64,
        read,
        count: 20_000,
        seconds,
    }
}
