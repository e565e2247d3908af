//! Round trips of a request and its reply.

use std::time::Duration;

use super::{Case, Figure, Options, figure, pingpong::short};
use crate::{
    job::{Outcome, Role, RoundTrips},
    peers::PeerInfo,
    world::{Failure, TIMEOUT, World},
};

pub(super) fn cases(options: &Options) -> Vec<Box<dyn Case>> {
    let seconds = options.seconds.unwrap_or(1.0);
    vec![Box::new(Service(short(options.read, seconds)))]
}

struct Service(RoundTrips);

impl Case for Service {
    fn label(&self) -> String {
        format!("{}B", self.0.len)
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        let mut world = World::new(peer)?;
        let server = world.start("server", Role::Server(self.0.clone()))?;
        world.ready(server)?;
        let client = world.start("client", Role::Client(self.0.clone()))?;
        world.ready(client)?;
        world.send_word(client, "go");
        let limit = TIMEOUT + Duration::from_secs_f64(self.0.seconds);
        let outcome = world.outcome(client, limit)?;
        world.send_word(server, "stop");
        let Outcome::RoundTrips {
            round_trip_ns,
            torn,
            ..
        } = outcome
        else {
            return Ok(Vec::new());
        };
        Ok(vec![
            figure("round_trip_p50", "us", round_trip_ns.p50 / 1e3),
            figure("round_trip_mean", "us", round_trip_ns.mean / 1e3),
            figure("round_trip_p99", "us", round_trip_ns.p99 / 1e3),
            figure("torn", "messages", torn as f64),
        ])
    }
}
