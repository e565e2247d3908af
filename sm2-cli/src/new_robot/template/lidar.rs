//! Publishes the distance to an obstacle that comes nearer, in metres.

use sm2_node::{Node, Rate, Shutdown};

fn main() -> anyhow::Result<()> {
    // Ctrl-C and SIGTERM end the loop.
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("lidar").shutdown(&shutdown).connect()?;
    let mut parameters = node.parameters_builder();
    let max_range = parameters
        .parameter("max_range", 10.0)
        .range(1.0..=100.0)
        .description("the greatest distance, in metres")
        .add();
    let _parameters = parameters.declare()?;

    let distances = node.publisher::<f64>("distance")?;
    let mut rate = Rate::hz(10);
    let mut distance = 0.0;
    while rate.sleep_unless(&shutdown).is_some() {
        distance = if distance < 0.2 {
            max_range.get()
        } else {
            distance - 0.1
        };
        distances.publish(&distance)?;
    }
    println!("ends");
    Ok(())
}
