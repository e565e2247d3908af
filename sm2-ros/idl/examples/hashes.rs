//! Prints the types of a folder of packages as lines of JSON: name, RIHS01 hash, and text of the definitions.
//!
//! `cargo run -p sm2-ros-idl --example hashes -- sm2-ros/definitions`

use std::path::Path;

use sm2_ros_idl::Set;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("name a folder of packages")?;
    let mut set = Set::default();
    set.add_folder(Path::new(&folder))?;
    for message in set.types() {
        let (hash, text) = (set.hash(&message.name)?, set.text(&message.name)?);
        let text = text.replace('\\', "\\\\").replace('"', "\\\"");
        let text = text.replace('\n', "\\n").replace('\t', "\\t");
        println!(
            "{{\"name\": \"{}\", \"hash\": \"{hash}\", \"text\": \"{text}\"}}",
            message.name
        );
    }
    Ok(())
}
