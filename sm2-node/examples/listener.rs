//! Prints the messages of a talker: `listener [COUNT]`.

mod common;

use std::io::{Write, stdout};
use std::process::ExitCode;

use common::Outcome;
use sm2_node::Node;

fn main() -> ExitCode {
    common::run(listen)
}

fn listen() -> Outcome {
    let count = common::argument(1, u64::MAX)?;
    let node = Node::new("listener")?;
    let subscriber = node.subscriber::<str>("chatter")?;
    for _ in 0..count {
        let sample = subscriber.recv()?;
        writeln!(stdout(), "{} said: {}", sample.publisher(), &*sample)?;
    }
    Ok(())
}
