//! Asks for a sum: `add_client NUMBER...`.

use std::error::Error;
use std::time::Duration;

use sm2_node::Node;

fn main() -> Result<(), Box<dyn Error>> {
    let numbers =
        (std::env::args().skip(1).map(|it| it.parse())).collect::<Result<Vec<f64>, _>>()?;
    let node = Node::new("add-client")?;
    let client = node.client::<[f64], f64>("add")?;
    client.wait_for_servers(1, Some(Duration::from_secs(5)))?;
    let sum = client.call(&numbers, Duration::from_secs(1))?;
    println!("{} says {}", sum.server(), *sum);
    Ok(())
}
