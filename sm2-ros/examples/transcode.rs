//! Decodes messages and encodes them again, for the comparison with another implementation.
//!
//! Each line of standard input has the name of a type and a message in hexadecimal digits. The answer is a line
//! with the bytes that the message has after it was decoded to JSON and encoded again, and with the JSON.
//!
//! `cargo run -p sm2-ros --example transcode -- sm2-ros/definitions`

use std::io::{BufRead, stdin};
use std::path::Path;

use sm2_ros::{decode, encode};
use sm2_ros_idl::Set;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("name a folder of packages")?;
    let mut set = Set::default();
    set.add_folder(Path::new(&folder))?;
    for line in stdin().lock().lines() {
        let line = line?;
        let (name, digits) = line
            .split_once(' ')
            .ok_or("expected a type and a message")?;
        let name = name.parse()?;
        let bytes = (0..digits.len() / 2)
            .map(|at| u8::from_str_radix(&digits[2 * at..][..2], 16))
            .collect::<Result<Vec<_>, _>>()?;
        let json = decode(&set, &name, &bytes, usize::MAX)?.to_json();
        let again = encode(&set, &name, &json)?;
        let again: String = again.iter().map(|byte| format!("{byte:02x}")).collect();
        println!("{again} {json}");
    }
    Ok(())
}
