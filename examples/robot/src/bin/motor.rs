//! Drives at the commanded speed. It stands without a command, and after an emergency stop.

use std::time::Duration;

use sm2_example_robot::Stop;
use sm2_node::{Event, Executor, Node, Shutdown, Timer};

#[derive(Default)]
struct Motor {
    commanded: f64,
    is_stopped: bool,
}

fn main() -> anyhow::Result<()> {
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("motor").shutdown(&shutdown).connect()?;
    let mut parameters = node.parameters_builder();
    let max_speed = parameters
        .parameter("max_speed", 1.0)
        .range(0.0..=3.0)
        .description("in metres per second")
        .add();
    let (_parameters, changes) = parameters.declare_with_changes()?;

    let commands = node.subscriber_builder::<f64>("motor/command");
    let commands = commands.deadline(Duration::from_millis(500)).declare()?;
    let stops = node.subscriber_builder::<Stop>("emergency/stop");
    let stops = stops.reliable(true).declare()?;
    let speeds = node.publisher_builder::<f64>("motor/speed");
    let speeds = speeds.liveliness(Duration::from_millis(500)).declare()?;
    let mut executor = Executor::new()?;
    executor.end_with(&shutdown)?;
    let group = executor.group(Motor::default());
    group.on_event(commands.events(), |motor, event| {
        if let Event::DeadlineMissed { .. } | Event::Left { .. } = event {
            motor.commanded = 0.0;
        }
        Ok(())
    });
    group.on_message(commands, |motor, speed| {
        motor.commanded = *speed?;
        Ok(())
    });
    group.on_message(stops, |motor, stop| {
        let stop = stop?;
        println!("{}: {}", if stop.on { "stop" } else { "go" }, stop.reason);
        motor.is_stopped = stop.on;
        Ok(())
    });
    group.on_change(changes, |motor, change| {
        let change = change?;
        match motor.is_stopped && change.get(&max_speed) > max_speed.get() {
            true => change.refuse("an emergency stop is on"),
            false => drop(change.accept()),
        }
        Ok(())
    });
    group.on_tick(Timer::hz(50), |motor, _| {
        let speed = motor.commanded.min(max_speed.get());
        speeds.publish(if motor.is_stopped { &0.0 } else { &speed })?;
        Ok(())
    });
    Ok(executor.run()?)
}
