//! A node that gives the same outputs in each replay: distances in, their mean out. `filter_lockstep` runs on a robot
//! and in the lockstep of `sm2 play --lockstep 1`.

mod common;

use std::process::ExitCode;
use std::time::Duration;

use common::Outcome;
use sm2_node::lockstep::Inputs;
use sm2_node::{Node, Publisher, Shutdown};

/// Everything that the outputs depend on.
struct Filter {
    mean: f32,
    output: Publisher<f32>,
}

fn main() -> ExitCode {
    common::run(filter)
}

fn filter() -> Outcome {
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("filter").shutdown(&shutdown).connect()?;
    let output = node.publisher::<f32>("mean")?;
    let distances = node
        .subscriber_builder::<f32>("distance")
        .depth(64)
        .declare()?;

    let mut inputs = Inputs::new(&node)?;
    inputs.on_message(distances, |filter: &mut Filter, distance, _now| {
        filter.mean += (*distance - filter.mean) / 8.0;
        Ok(())
    })?;
    inputs.on_tick(
        Duration::from_millis(100),
        |filter: &mut Filter, _tick, _now| {
            filter.output.publish(&filter.mean)?;
            Ok(())
        },
    );
    inputs.run(&mut Filter { mean: 0.0, output })?;
    Ok(())
}
