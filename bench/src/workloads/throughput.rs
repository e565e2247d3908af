//! Small messages as fast as possible, none lost.

use super::{
    Case, Figure, Options, figure,
    stream::{Setting, memory_alone, run},
};
use crate::{peers::PeerInfo, world::Failure};

pub(super) fn cases(options: &Options) -> Vec<Box<dyn Case>> {
    vec![Box::new(Throughput(Setting {
        len: 64,
        subscribers: 1,
        rate_hz: None,
        seconds: options.seconds.unwrap_or(2.0),
        read: options.read,
        depth: 1_024,
        lossless: true,
        stamped: false,
    }))]
}

struct Throughput(Setting);

impl Case for Throughput {
    fn label(&self) -> String {
        format!("{}B", self.0.len)
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        if peer.name == "raw-memcpy" {
            let (hz, _) = memory_alone(peer, &self.0)?;
            return Ok(vec![figure("received_hz", "Hz", hz)]);
        }
        let run = run(peer, &self.0)?;
        Ok([run.rate(), run.losses(), run.costs()].concat())
    }
}
