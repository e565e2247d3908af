//! Asks a server for a sum: `add_client NUMBER...`.

use std::error::Error;
use std::process::ExitCode;
use std::time::Duration;

use sm2_node::Node;

fn main() -> ExitCode {
    match ask() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("add_client: {error}");
            ExitCode::FAILURE
        }
    }
}

fn ask() -> Result<(), Box<dyn Error>> {
    let numbers = std::env::args().skip(1).map(|it| it.parse());
    let numbers = numbers.collect::<Result<Vec<f64>, _>>()?;
    let node = Node::new("add-client")?;
    let client = node.client::<[f64], f64>("add")?;
    client.wait_for_servers_timeout(1, Duration::from_secs(5))?;
    let sum = client.call_timeout(&numbers, Duration::from_secs(1))?;
    println!("{} says {}", sum.server(), *sum);
    Ok(())
}
