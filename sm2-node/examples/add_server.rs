//! Adds numbers for whoever asks: `add_server [COUNT]`.

use std::error::Error;

use sm2_node::Node;

fn main() -> Result<(), Box<dyn Error>> {
    let count = std::env::args()
        .nth(1)
        .map_or(Ok(usize::MAX), |it| it.parse())?;
    let node = Node::new("add-server")?;
    let server = node.server::<[f64], f64>("add")?;
    for _ in 0..count {
        let request = server.recv()?;
        println!("{} asks for the sum of {:?}", request.client(), &*request);
        if request.is_empty() {
            request.fail("nothing to add")?;
        } else {
            let sum = request.iter().sum();
            request.reply(&sum)?;
        }
    }
    Ok(())
}
