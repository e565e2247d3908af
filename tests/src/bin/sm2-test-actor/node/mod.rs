//! `node`: a node that executes commands. Each line of standard input is a command, and its answer
//! is a line, `ok …` or `error …`. Between commands it drives its sockets. `--ring-lane on` or
//! `off` sets whether it offers the ring lane, whatever the environment sets. `--manager-timeout-ms N`
//! sets how long it waits for a Manager; by default it waits until the test has failed.

mod commands;
mod declare;

use std::{os::fd::AsFd, process::ExitCode, time::Duration};

use commands::Stage;
use sm2_node::Node;

use sm2_tests::{TIMEOUT, input::Input, options::Options};

pub(crate) fn run(options: &Options) -> ExitCode {
    let name: String = options.get("--name").expect("--name");
    let socket: String = options.get("--socket").expect("--socket");
    let timeout_ms = options.get("--manager-timeout-ms");
    let mut builder = Node::builder(&name)
        .socket(socket)
        .manager_timeout(timeout_ms.map_or(TIMEOUT, Duration::from_millis));
    if let Some(lane) = options.get::<String>("--ring-lane") {
        builder = builder.ring_lane(lane == "on");
    }
    let node = match builder.connect() {
        Ok(node) => node,
        Err(error) => {
            println!("failed {error:?}: {error}");
            return ExitCode::FAILURE;
        }
    };
    println!("ready");
    let mut stage = Stage::new(node.clone());
    let mut input = Input::new();
    loop {
        sm2_io::wait_readable(&[input.as_fd(), node.as_fd()], None).expect("poll");
        node.spin_some().expect("the node's own wait");
        match input.lines() {
            Ok(lines) => lines
                .iter()
                .for_each(|line| println!("{}", stage.execute(line))),
            Err(_) => return ExitCode::SUCCESS,
        }
    }
}
