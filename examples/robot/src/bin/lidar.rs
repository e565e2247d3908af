//! Publishes scans: 720 distances in metres, counter-clockwise from the back.

use sm2_node::{Node, Rate, Shutdown};

fn main() -> anyhow::Result<()> {
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("lidar").shutdown(&shutdown).connect()?;
    let mut parameters = node.parameters_builder();
    let max_range = parameters
        .parameter("max_range", 30.0)
        .range(0.5..=100.0)
        .description("the greatest distance, in metres")
        .add();
    let _parameters = parameters.declare()?;

    let scans = node.publisher::<[f32]>("scan")?;
    let mut rate = Rate::hz(10);
    while let Some(tick) = rate.sleep_unless(&shutdown) {
        let wall = 2.0 + (tick.number % 50) as f32 / 10.0;
        let mut scan = scans.loan_slice(720)?;
        scan.fill(wall.min(max_range.get() as f32));
        scan.publish()?;
    }
    Ok(())
}
