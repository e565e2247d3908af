//! Many nodes join, and then are idle.

use std::{
    thread,
    time::{Duration, Instant},
};

use super::{Case, Figure, Options, figure};
use crate::{
    job::{ProcessEvent, Role},
    peers::PeerInfo,
    world::{Failure, World},
};

/// Timeout until all nodes have connected to their neighbours.
const JOINING: Duration = Duration::from_secs(120);

/// The time after which nodes are idle, unless their discovery never ends.
const SETTLING: Duration = Duration::from_secs(2);

pub(super) fn cases(options: &Options) -> Vec<Box<dyn Case>> {
    let counts = options.nodes.map_or(vec![50, 100], |count| vec![count]);
    let idle = Duration::from_secs_f64(options.seconds.unwrap_or(4.0));
    counts
        .into_iter()
        .map(|count| Box::new(Nodes { count, idle }) as Box<dyn Case>)
        .collect()
}

struct Nodes {
    count: usize,
    /// How long the idle nodes are measured.
    idle: Duration,
}

impl Case for Nodes {
    fn label(&self) -> String {
        format!("{}nodes", self.count)
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        let mut world = World::new(peer)?;
        let start = Instant::now();
        let mut nodes = Vec::new();
        for number in 0..self.count {
            let role = Role::Node {
                number,
                count: self.count,
            };
            nodes.push(world.start(&format!("node-{number}"), role)?);
        }
        for node in nodes {
            let left = JOINING.saturating_sub(start.elapsed());
            world.expect(node, &ProcessEvent::Ready, "join", left)?;
        }
        let ready = start.elapsed();
        let cpu_ready = world.cpu_ns()?;
        thread::sleep(SETTLING);
        let (cpu_settled, sleeps, settled) = (world.cpu_ns()?, world.sleeps()?, Instant::now());
        thread::sleep(self.idle);
        let (cpu_idle, slept) = (world.cpu_ns()?, world.sleeps()?);
        let idle_s = settled.elapsed().as_secs_f64();
        let pss = world.pss_bytes()?;
        let since = |now: u64, before: u64| now.saturating_sub(before) as f64;
        let idle_percent = since(cpu_idle, cpu_settled) / 1e9 / idle_s * 100.0;
        Ok(vec![
            figure("all_ready", "s", ready.as_secs_f64()),
            figure("cpu_to_ready", "s", cpu_ready as f64 / 1e9),
            figure("cpu_to_settle", "s", cpu_settled as f64 / 1e9),
            figure("idle_cpu", "%", idle_percent),
            figure("idle_wakeups", "1/s", since(slept, sleeps) / idle_s),
            figure("pss", "MB", pss as f64 / 1e6),
        ])
    }
}
