//! Prints what a talker says: `listener [COUNT]`.

use std::error::Error;

use sm2_node::Node;

fn main() -> Result<(), Box<dyn Error>> {
    let count = std::env::args()
        .nth(1)
        .map_or(Ok(usize::MAX), |it| it.parse())?;
    let node = Node::new("listener")?;
    let subscriber = node.subscriber::<str>("chatter")?;
    for _ in 0..count {
        let sample = subscriber.recv()?;
        println!("{} said: {}", sample.publisher(), &*sample);
    }
    Ok(())
}
