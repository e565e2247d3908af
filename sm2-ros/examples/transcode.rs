//! Decodes messages and encodes them again, for the comparison with another implementation.
//!
//! Each line of standard input has the name of a type and a message in hexadecimal digits. The answer is a line with
//! three parts: the bytes that the message has after it was decoded to JSON and encoded again; the bytes that it has
//! after its Rust type decoded and encoded it, or `-` for a type without one; and the JSON.
//!
//! `cargo run -p sm2-ros --example transcode --features common-interfaces -- sm2-ros/definitions`

use std::fmt::Write as _;
use std::io::{BufRead, stdin};
use std::path::Path;

use sm2_ros::cdr::{from_slice, to_vec};
use sm2_ros::{Type, TypeVisitor, decode, encode, for_each_type};
use sm2_ros_idl::Set;

type Error = Box<dyn std::error::Error>;

fn main() -> Result<(), Error> {
    let folder = std::env::args().nth(1).ok_or("name a folder of packages")?;
    let mut set = Set::default();
    set.add_folder(Path::new(&folder))?;
    for line in stdin().lock().lines() {
        let line = line?;
        let (name, digits) = line
            .split_once(' ')
            .ok_or("expected a type and a message")?;
        let bytes = (0..digits.len() / 2)
            .map(|at| u8::from_str_radix(&digits[2 * at..][..2], 16))
            .collect::<Result<Vec<_>, _>>()?;
        let type_name = name.parse()?;
        let json = serde_json::to_value(decode(&set, &type_name, &bytes, usize::MAX)?)?;
        let again = digits_of(&encode(&set, &type_name, &json)?);
        let mut typed = Typed {
            name,
            bytes: &bytes,
            again: None,
        };
        for_each_type(&mut typed);
        let typed = typed.again.transpose()?.map(|it| digits_of(&it));
        println!("{again} {} {json}", typed.as_deref().unwrap_or("-"));
    }
    Ok(())
}

/// Decodes and encodes a message by the Rust type of this name.
struct Typed<'a> {
    name: &'a str,
    bytes: &'a [u8],
    again: Option<Result<Vec<u8>, Error>>,
}

impl TypeVisitor for Typed<'_> {
    fn visit<T: Type>(&mut self) {
        if T::TYPE_NAME == self.name {
            let message = from_slice::<T>(self.bytes).map_err(Error::from);
            self.again = Some(message.and_then(|it| Ok(to_vec(&it)?)));
        }
    }
}

fn digits_of(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut digits, byte| {
        // Writing to a `String` does not fail.
        let _never = write!(digits, "{byte:02x}");
        digits
    })
}
