//! A program that systemd supervises: `supervised [STEPS]`. In its unit:
//!
//! ```text
//! [Service]
//! Type=notify
//! WatchdogSec=500ms
//! Restart=always
//! ```
//!
//! systemd then starts other units after this one is ready, and kills and restarts it when its control loop hangs.

use std::error::Error;
use std::process::ExitCode;

use sd_notify::NotifyState;
use sm2_node::{Executor, Node, Shutdown, Timer};

fn main() -> ExitCode {
    match control() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("supervised: {error}");
            ExitCode::FAILURE
        }
    }
}

fn control() -> Result<(), Box<dyn Error>> {
    let most = match std::env::args().nth(1) {
        Some(text) => text.parse()?,
        None => u64::MAX,
    };
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("control").shutdown(&shutdown).connect()?;
    let speeds = node.publisher::<f64>("speed")?;
    let mut executor = Executor::new()?;
    executor.end_with(&shutdown)?;
    let control = executor.group(0);
    control.on_tick(Timer::hz(100), |steps, _| {
        *steps += 1;
        speeds.publish(&0.5)?;
        if *steps >= most {
            shutdown.request();
        }
        Ok(())
    });
    // In the group of the control loop: a callback of the loop that hangs also stops the signs of life.
    if let Some(limit) = sd_notify::watchdog_enabled() {
        control.on_tick(Timer::every(limit / 2), |_, _| {
            Ok(sd_notify::notify(&[NotifyState::Watchdog])?)
        });
    }
    sd_notify::notify(&[NotifyState::Ready])?;
    executor.run()?;
    Ok(sd_notify::notify(&[NotifyState::Stopping])?)
}
