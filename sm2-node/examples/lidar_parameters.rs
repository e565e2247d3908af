//! A node with parameters: `lidar_parameters [FILE...]`. The files hold values, as `sm2 param dump lidar` prints them.

use std::error::Error;
use std::process::ExitCode;
use std::time::Duration;

use sm2_node::{Executor, Node, Shutdown, Timer};

fn main() -> ExitCode {
    match scan() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("lidar: {error}");
            ExitCode::FAILURE
        }
    }
}

fn scan() -> Result<(), Box<dyn Error>> {
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("lidar").shutdown(&shutdown).connect()?;
    let files = std::env::args_os().skip(1);
    let mut builder = node.parameters_builder().files(files);
    let min_range = builder
        .parameter("min_range", 0.5)
        .range(0.0..=100.0)
        .description("the least distance that is published, in metres")
        .add();
    let max_range = builder
        .parameter("max_range", 30.0)
        .range(0.0..=100.0)
        .description("the greatest distance that is published, in metres")
        .add();
    let frame = builder
        .parameter("frame", "laser".to_owned())
        .description("the frame of the distances")
        .read_only(true)
        .add();
    let (_parameters, changes) = builder.declare_with_changes()?;
    let show = || {
        println!(
            "{}: {} m to {} m",
            frame.get(),
            min_range.get(),
            max_range.get()
        )
    };
    show();

    let scans = node.publisher::<[f64]>("scan")?;
    let mut executor = Executor::new()?;
    executor.end_with(&shutdown)?;
    let group = executor.group(());
    group.on_change(changes, |(), change| {
        let change = change?;
        if change.get(&min_range) < change.get(&max_range) {
            change.accept();
            show();
        } else {
            change.refuse("min_range has to be less than max_range");
        }
        Ok(())
    });
    group.on_tick(Timer::every(Duration::from_millis(100)), |(), _| {
        let mut scan = vec![0.25, 2.5, 20.0, 80.0];
        scan.retain(|it| (min_range.get()..=max_range.get()).contains(it));
        scans.publish(&scan)?;
        Ok(())
    });
    Ok(executor.run()?)
}
