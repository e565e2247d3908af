//! One program with a camera, a 100 Hz control loop, two services and a timer, without an event loop of its own:
//! `robot [SECONDS]`. Ctrl-C ends it as well.

use std::error::Error;
use std::process::ExitCode;
use std::time::Duration;

use sm2_node::{Executor, Node, Shutdown, Timer};

#[derive(Default)]
struct Robot {
    speed: f64,
    brightness: u8,
    steps: u64,
}

fn main() -> ExitCode {
    match drive() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("robot: {error}");
            ExitCode::FAILURE
        }
    }
}

fn drive() -> Result<(), Box<dyn Error>> {
    let seconds = match std::env::args().nth(1) {
        Some(text) => text.parse()?,
        None => u64::MAX,
    };
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("robot").shutdown(&shutdown).connect()?;
    let images = node.publisher::<[u8]>("camera/image")?;
    let speeds = node.publisher::<f64>("speed")?;
    let mut executor = Executor::new()?;
    executor.end_with(&shutdown)?;
    executor.group(()).on_tick(Timer::hz(30), |(), tick| {
        let mut image = images.loan_slice(640 * 480)?;
        image.fill(tick.number as u8);
        image.publish()?;
        Ok(())
    });
    let control = executor.group(Robot::default());
    control.on_message(node.subscriber::<[u8]>("camera/image")?, |robot, image| {
        robot.brightness = image?[0];
        Ok(())
    });
    control.on_tick(Timer::hz(100), |robot, _| {
        robot.steps += 1;
        speeds.publish(&robot.speed)?;
        Ok(())
    });
    control.on_request(node.server::<f64, f64>("set_speed")?, |robot, request| {
        let request = request?;
        let before = std::mem::replace(&mut robot.speed, *request);
        Ok(request.reply(&before)?)
    });
    control.on_request(node.server::<str, u64>("steps")?, |robot, request| {
        Ok(request?.reply(&robot.steps)?)
    });
    control.on_tick(Timer::once(Duration::from_secs(seconds)), |robot, _| {
        println!("{} steps, brightness {}", robot.steps, robot.brightness);
        shutdown.request();
        Ok(())
    });
    Ok(executor.run_threads(2)?)
}
