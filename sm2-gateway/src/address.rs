//! Addresses of peers in configurations.

use std::{
    fmt, io,
    net::{SocketAddr, ToSocketAddrs},
    str::FromStr,
};

/// An address with a port, or a host name with a port, which is looked up at each attempt to connect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// `192.0.2.1:7633`, `[fe80::1%2]:7633`.
    At(SocketAddr),
    /// `robot.local:7633`.
    Host(String),
}

/// The text is not an [`Address`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "is neither an address with a port, such as 192.0.2.1:7633 or [fe80::1%2]:7633, nor the name of a \
     host with one, such as robot.local:7633"
)]
pub struct AddressError;

/// Length limit of a DNS name.
const HOST_MAX: usize = 253;
/// Length limit of a label of a DNS name.
const LABEL_MAX: usize = 63;

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        if let Ok(address) = text.parse() {
            return Ok(Self::At(address));
        }
        let (host, port) = text.rsplit_once(':').ok_or(AddressError)?;
        let is_port = port.bytes().all(|it| it.is_ascii_digit());
        match port.parse::<u16>() {
            Ok(1..) if is_port && is_host(host) => Ok(Self::Host(text.to_owned())),
            _ => Err(AddressError),
        }
    }
}

fn is_host(text: &str) -> bool {
    let name = text.strip_suffix('.').unwrap_or(text);
    let is_label = |it: &str| {
        let is_good = |byte: u8| byte.is_ascii_alphanumeric() || b"-_".contains(&byte);
        (1..=LABEL_MAX).contains(&it.len())
            && it.bytes().all(is_good)
            && !it.starts_with('-')
            && !it.ends_with('-')
    };
    // A numeric last label is a mistyped IPv4 address.
    let last = name.rsplit('.').next().unwrap_or(name);
    let is_number = last.bytes().all(|it| it.is_ascii_digit());
    name.len() <= HOST_MAX && name.split('.').all(is_label) && !is_number
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::At(address) => address.fmt(f),
            Self::Host(host) => f.write_str(host),
        }
    }
}

/// Returns the addresses of a host and port.
pub(crate) type LookUp = fn(&str) -> io::Result<Vec<SocketAddr>>;

/// Asks the system, which may ask the DNS.
pub(crate) fn system_look_up(host: &str) -> io::Result<Vec<SocketAddr>> {
    host.to_socket_addrs().map(Iterator::collect)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_names_and_what_is_neither() {
        for text in ["192.0.2.1:7633", "[2001:db8::1]:7633", "[fe80::1%2]:7633"] {
            assert!(matches!(text.parse(), Ok(Address::At(_))), "{text}");
        }
        let label = "a".repeat(63);
        let long = format!("{label}.{label}.{label}.{}:1", "a".repeat(61));
        for text in [
            "robot.local:7633",
            "base:1",
            "a-b.c_d.:65535",
            "4you:80",
            "x.1a:1",
            &long,
        ] {
            let address = text.parse();
            assert_eq!(address, Ok(Address::Host(text.to_owned())));
            assert_eq!(address.unwrap().to_string(), text);
        }
        let label = format!("{label}a:1");
        let long = format!("a{long}");
        for text in [
            "",
            ":1",
            "robot",
            "robot.local",
            "robot:",
            "robot:0",
            "robot:65536",
            "robot:+1",
            "192.0.2.300:1",
            "1:1",
            "fe80::1:7633",
            "a..b:1",
            ".:1",
            "-a:1",
            "a-:1",
            "a b:1",
            "r\u{f6}bot:1",
            "http://robot:1",
            "robot/x:1",
            &label,
            &long,
        ] {
            assert_eq!(text.parse::<Address>(), Err(AddressError), "{text}");
        }
    }
}
