//! Says something ten times a second: `talker [COUNT]`.

use std::error::Error;
use std::time::Duration;

use sm2_node::Node;

fn main() -> Result<(), Box<dyn Error>> {
    let count = std::env::args()
        .nth(1)
        .map_or(Ok(u64::MAX), |it| it.parse())?;
    let node = Node::new("talker")?;
    let publisher = node.publisher::<str>("chatter")?;
    publisher.wait_for_subscribers(1, None)?;
    for number in 1..=count {
        publisher.publish(&format!("hello {number}"))?;
        node.spin_for(Duration::from_millis(100))?;
    }
    Ok(())
}
