//! Makes a map of detections and scans of the same time, and commands the speed of the motor.

use std::f32::consts::TAU;
use std::time::Duration;

use sm2_example_robot::{Detections, Map};
use sm2_node::synchronizer::Input;
use sm2_node::{Executor, Instant, Node, Shutdown, Synchronizer};

fn main() -> anyhow::Result<()> {
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("map").shutdown(&shutdown).connect()?;
    let maps = node.publisher_builder::<Map>("map").latched(1).declare()?;
    let speeds = node.publisher_builder::<f64>("motor/command");
    let speeds = speeds.deadline(Duration::from_millis(500)).declare()?;

    // A detection is as old as its image; the time of a scan is that of its publication.
    let detections = Input::new(node.subscriber_builder::<Detections>("detections"));
    let detections = detections.time(|it| Instant(it.time_ns));
    let scans = node.subscriber_builder::<[f32]>("scan");
    let both = Synchronizer::approximate((detections, scans));
    let both = both.max_interval(Duration::from_millis(50)).declare()?;
    let mut executor = Executor::new()?;
    executor.end_with(&shutdown)?;
    executor.group(()).on_set(both, |(), set| {
        let (detections, scan) = set?;
        let place = |bearing: &f32| {
            let ray = (bearing / TAU + 0.5) * scan.len() as f32;
            let distance = scan[ray as usize % scan.len()];
            (distance * bearing.cos(), distance * bearing.sin())
        };
        let obstacles: Vec<_> = detections.bearings.iter().map(place).collect();
        let ahead = obstacles.iter().map(|it| f64::from(it.0));
        let nearest = ahead.fold(f64::INFINITY, f64::min);
        speeds.publish(&(nearest - 1.0).clamp(0.0, 2.0))?;
        let time_ns = detections.time_ns;
        maps.publish(&Map { time_ns, obstacles })?;
        Ok(())
    });
    Ok(executor.run()?)
}
