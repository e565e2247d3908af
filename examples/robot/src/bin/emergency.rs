//! Stops the motor when it shows no sign of life, and when the service `emergency/set` asks for it.

use std::time::Duration;

use sm2_example_robot::Stop;
use sm2_node::{Event, Executor, Node, Shutdown};

fn main() -> anyhow::Result<()> {
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("emergency").shutdown(&shutdown).connect()?;
    let stops = node.publisher_builder::<Stop>("emergency/stop");
    let stops = stops.reliable(true).latched(1).declare()?;
    let speeds = node.subscriber_builder::<f64>("motor/speed");
    let speeds = speeds.liveliness(Duration::from_millis(500)).declare()?;
    let requests = node.server::<Stop, str>("emergency/set")?;
    let mut executor = Executor::new()?;
    executor.end_with(&shutdown)?;
    let group = executor.group(());
    group.on_event(speeds.events(), |(), event| {
        let reason = match event {
            Event::LivelinessLost { .. } => "the motor hangs".to_owned(),
            Event::Left { end, .. } => format!("the motor is gone: {end}"),
            _ => return Ok(()),
        };
        stops.publish(&Stop { on: true, reason })?;
        Ok(())
    });
    // The speeds themselves do not matter here, but messages that are not taken count as lost.
    group.on_message(speeds, |(), speed| Ok(speed.map(drop)?));
    group.on_request(requests, |(), request| {
        let request = request?;
        stops.publish(&request)?;
        Ok(request.reply("published")?)
    });
    Ok(executor.run()?)
}
