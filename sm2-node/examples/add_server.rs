//! Serves sums of numbers: `add_server [COUNT]`. Ctrl-C ends it as well.

use std::error::Error;
use std::process::ExitCode;

use sm2_node::{Node, RecvError, Shutdown};

fn main() -> ExitCode {
    match serve() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("add_server: {error}");
            ExitCode::FAILURE
        }
    }
}

fn serve() -> Result<(), Box<dyn Error>> {
    let count = match std::env::args().nth(1) {
        Some(text) => text.parse()?,
        None => u64::MAX,
    };
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("add-server").shutdown(&shutdown).connect()?;
    let server = node.server::<[f64], f64>("add")?;
    for _ in 0..count {
        let request = match server.recv() {
            Err(RecvError::Shutdown) => break,
            request => request?,
        };
        let (client, numbers) = (request.client(), &*request);
        println!("{client} asks for the sum of {numbers:?}");
        if request.is_empty() {
            request.fail("nothing to add")?;
        } else {
            let sum = request.iter().sum();
            request.reply(&sum)?;
        }
    }
    Ok(())
}
