//! The paper's figure 3: CPU and memory of 10 MB messages at 10 Hz.

use super::{
    Case, Figure, Options,
    stream::{Setting, run},
};
use crate::{peers::PeerInfo, world::Failure};

pub(super) fn cases(options: &Options) -> Vec<Box<dyn Case>> {
    [1, 5]
        .map(|subscribers| {
            Box::new(Fig3(Setting {
                len: options.size,
                subscribers,
                rate_hz: Some(10.0),
                seconds: options.seconds.unwrap_or(4.0),
                read: options.read,
                depth: 1,
                lossless: false,
                stamped: true,
            })) as Box<dyn Case>
        })
        .into()
}

struct Fig3(Setting);

impl Case for Fig3 {
    fn label(&self) -> String {
        format!("1to{}", self.0.subscribers)
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        let run = run(peer, &self.0)?;
        Ok([run.costs(), run.latency(), run.rate(), run.losses()].concat())
    }
}
