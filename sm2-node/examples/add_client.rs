//! Asks a server for a sum: `add_client NUMBER...`.

mod common;

use std::io::{Write, stdout};
use std::process::ExitCode;
use std::time::Duration;

use common::Outcome;
use sm2_node::Node;

fn main() -> ExitCode {
    common::run(ask)
}

fn ask() -> Outcome {
    let given = 1..std::env::args().len();
    let numbers = given.map(|at| common::argument(at, 0.0));
    let numbers = numbers.collect::<Outcome<Vec<f64>>>()?;
    let node = Node::new("add-client")?;
    let client = node.client::<[f64], f64>("add")?;
    client.wait_for_servers_timeout(1, Duration::from_secs(5))?;
    let sum = client.call_timeout(&numbers, Duration::from_secs(1))?;
    writeln!(stdout(), "{} says {}", sum.server(), *sum)?;
    Ok(())
}
