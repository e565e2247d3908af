//! The paper's figure 4: 10 MB messages to five subscribers, at increasing rates.

use super::{
    Case, Figure, Options, figure,
    stream::{Setting, memory_alone, run},
};
use crate::{peers::PeerInfo, world::Failure};

/// Messages per second.
const TARGETS_HZ: [f64; 7] = [10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0];

pub(super) fn cases(options: &Options) -> Vec<Box<dyn Case>> {
    TARGETS_HZ
        .map(|target| case(options, Some(target), &format!("{target}Hz")))
        .into_iter()
        .chain([case(options, None, "max")])
        .collect()
}

pub(super) fn cases_max(options: &Options) -> Vec<Box<dyn Case>> {
    vec![case(options, None, "")]
}

fn case(options: &Options, rate_hz: Option<f64>, label: &str) -> Box<dyn Case> {
    let setting = Setting {
        len: options.size,
        subscribers: 5,
        rate_hz,
        seconds: options.seconds.unwrap_or(2.0),
        read: options.read,
        depth: 1,
        lossless: false,
        stamped: true,
    };
    Box::new(Fig4 {
        setting,
        label: label.to_owned(),
    })
}

struct Fig4 {
    setting: Setting,
    label: String,
}

impl Case for Fig4 {
    fn label(&self) -> String {
        self.label.clone()
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        if peer.name == "raw-memcpy" {
            let (hz, _) = memory_alone(peer, &self.setting)?;
            return Ok(vec![figure("received_hz", "Hz", hz)]);
        }
        let run = run(peer, &self.setting)?;
        Ok([run.rate(), run.losses(), run.latency(), run.costs()].concat())
    }
}
