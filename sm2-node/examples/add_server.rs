//! Serves sums of numbers: `add_server [COUNT]`.

mod common;

use std::io::{Write, stdout};
use std::process::ExitCode;

use common::Outcome;
use sm2_node::Node;

fn main() -> ExitCode {
    common::run(serve)
}

fn serve() -> Outcome {
    let count = common::argument(1, u64::MAX)?;
    let node = Node::new("add-server")?;
    let server = node.server::<[f64], f64>("add")?;
    for _ in 0..count {
        let request = server.recv()?;
        let (client, numbers) = (request.client(), &*request);
        writeln!(stdout(), "{client} asks for the sum of {numbers:?}")?;
        if request.is_empty() {
            request.fail("nothing to add")?;
        } else {
            let sum = request.iter().sum();
            request.reply(&sum)?;
        }
    }
    Ok(())
}
