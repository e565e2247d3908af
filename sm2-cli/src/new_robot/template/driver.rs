//! Publishes the speed, in metres per second: 0 in front of an obstacle.

use sm2_node::{Executor, Node, Shutdown};

fn main() -> anyhow::Result<()> {
    // Ctrl-C and SIGTERM end the executor.
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("driver").shutdown(&shutdown).connect()?;
    let mut parameters = node.parameters_builder();
    let stop_distance = parameters
        .parameter("stop_distance", 1.0)
        .range(0.0..=10.0)
        .description("the distance at which the robot stops, in metres")
        .add();
    let speed = parameters
        .parameter("speed", 0.5)
        .range(0.0..=2.0)
        .description("the speed on a free way, in metres per second")
        .add();
    let _parameters = parameters.declare()?;

    let speeds = node.publisher::<f64>("speed")?;
    let distances = node.subscriber::<f64>("distance")?;
    let mut executor = Executor::new()?;
    executor.end_with(&shutdown)?;
    executor.group(()).on_message(distances, |(), distance| {
        let is_free = *distance? > stop_distance.get();
        speeds.publish(&if is_free { speed.get() } else { 0.0 })?;
        Ok(())
    });
    executor.run()?;
    println!("ends");
    Ok(())
}
