//! The paper's figure 5: latency by the number of subscribers.

use super::{
    Case, Figure, Options,
    stream::{Setting, run},
};
use crate::{peers::PeerInfo, world::Failure};

pub(super) fn cases(options: &Options) -> Vec<Box<dyn Case>> {
    (1..=8)
        .map(|subscribers| {
            Box::new(Fig5(Setting {
                len: options.size,
                subscribers,
                rate_hz: Some(10.0),
                seconds: options.seconds.unwrap_or(2.0),
                read: options.read,
                depth: 1,
                lossless: false,
                stamped: true,
            })) as Box<dyn Case>
        })
        .collect()
}

struct Fig5(Setting);

impl Case for Fig5 {
    fn label(&self) -> String {
        format!("1to{}", self.0.subscribers)
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        let run = run(peer, &self.0)?;
        Ok([run.latency(), run.losses()].concat())
    }
}
