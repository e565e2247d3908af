//! A subscriber starts while a publisher is running.

use super::{Case, Figure, Options, figure};
use crate::{
    clock::now_ns,
    job::{Channel, Outcome, ProcessEvent, Role, Stream},
    peers::PeerInfo,
    stats::Durations,
    world::{Failure, TIMEOUT, World},
};

/// The number of subscribers in each run, one after the other.
const JOINERS: usize = 20;

pub(super) fn cases(_: &Options) -> Vec<Box<dyn Case>> {
    vec![Box::new(Join)]
}

struct Join;

impl Case for Join {
    fn label(&self) -> String {
        String::new()
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        let mut world = World::new(peer)?;
        let channel = Channel {
            name: "bench/join".to_owned(),
            max_len: 64,
            depth: 8,
            lossless: false,
            // The publisher does not wait for subscribers.
            subscribers: 0,
        };
        let stream = Stream {
            channel: channel.clone(),
            len: 64,
            rate_hz: Some(1_000.0),
            warm_up_s: 0.1,
            seconds: 3_600.0,
            stamped: true,
        };
        let publisher = world.start("publisher", Role::Publisher(stream))?;
        world.ready(publisher)?;
        world.send_word(publisher, "go");
        world.expect(publisher, &ProcessEvent::Measuring, "publish", TIMEOUT)?;
        let mut durations = Durations::default();
        for number in 0..JOINERS {
            let role = Role::Joiner {
                channel: Channel {
                    subscribers: 1,
                    ..channel.clone()
                },
                started_ns: now_ns(),
            };
            let joiner = world.start(&format!("joiner-{number}"), role)?;
            if let Outcome::Joined { after_ns } = world.outcome(joiner, TIMEOUT)? {
                durations.record(after_ns);
            }
            world.end(joiner);
        }
        let spread = durations.spread();
        Ok(vec![
            figure("first_message_p50", "ms", spread.p50 / 1e6),
            figure("first_message_mean", "ms", spread.mean / 1e6),
            figure("first_message_max", "ms", spread.max / 1e6),
        ])
    }
}
