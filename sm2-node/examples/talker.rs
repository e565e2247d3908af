//! Publishes a text ten times a second: `talker [COUNT]`.

mod common;

use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use common::Outcome;
use sm2_node::Node;

fn main() -> ExitCode {
    common::run(talk)
}

fn talk() -> Outcome {
    let count = common::argument(1, u64::MAX)?;
    let node = Node::new("talker")?;
    let publisher = node.publisher::<str>("chatter")?;
    publisher.wait_for_subscribers(1)?;
    for number in 1..=count {
        publisher.publish(&format!("hello {number}"))?;
        thread::sleep(Duration::from_millis(100));
    }
    Ok(())
}
