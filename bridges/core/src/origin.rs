//! The origin of a message.

use sm2_proto::{Name, NameError};

/// The first byte of the attachment.
const VERSION: u8 = 1;
/// The length of the attachment without the name, in bytes.
const FIXED_BYTES: usize = 1 + 8 + 8;

/// The bridge that has put a message into the network, and the number of the message.
///
/// As an attachment: the byte 1, the epoch and the number in 8 bytes each (little-endian), and the name.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Origin {
    /// The name of the bridge.
    pub bridge: Name,
    /// The start of the bridge, in nanoseconds since 1970 (UTC).
    pub epoch: u64,
    /// The number of the message, counted by its bridge for each topic.
    pub number: u64,
}

/// The reason why an attachment is not an [`Origin`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WrongOrigin {
    /// It is too short.
    #[error("an origin has more than {FIXED_BYTES} bytes, this attachment has {0}")]
    Short(usize),
    /// It is of another version.
    #[error("this bridge knows version {VERSION} of origins, the attachment has version {0}")]
    Version(u8),
    /// The name is not UTF-8.
    #[error("the name of the bridge is not UTF-8")]
    Text,
    /// The name is not a legal name.
    #[error("the name of the bridge is wrong: {0}")]
    Name(#[from] NameError),
}

impl Origin {
    /// The attachment.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(FIXED_BYTES + self.bridge.as_str().len());
        bytes.push(VERSION);
        bytes.extend(self.epoch.to_le_bytes());
        bytes.extend(self.number.to_le_bytes());
        bytes.extend(self.bridge.as_str().as_bytes());
        bytes
    }

    /// Reads an attachment.
    ///
    /// # Errors
    ///
    /// See [`WrongOrigin`].
    pub fn decode(bytes: &[u8]) -> Result<Self, WrongOrigin> {
        let short = WrongOrigin::Short(bytes.len());
        let (version, rest) = bytes.split_first().ok_or(short)?;
        if *version != VERSION {
            return Err(WrongOrigin::Version(*version));
        }
        let (epoch, rest) = rest.split_first_chunk().ok_or(short)?;
        let (number, name) = rest.split_first_chunk().ok_or(short)?;
        let name = str::from_utf8(name).map_err(|_| WrongOrigin::Text)?;
        Ok(Self {
            bridge: Name::new(name)?,
            epoch: u64::from_le_bytes(*epoch),
            number: u64::from_le_bytes(*number),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_comes_back_and_nothing_else_is_one() {
        let origin = Origin {
            bridge: Name::new("robot/7").unwrap(),
            epoch: 1 << 60,
            number: u64::MAX,
        };
        let bytes = origin.encode();
        assert_eq!(Origin::decode(&bytes), Ok(origin));
        for len in 0..FIXED_BYTES {
            assert_eq!(Origin::decode(&bytes[..len]), Err(WrongOrigin::Short(len)));
        }
        assert!(matches!(
            Origin::decode(&bytes[..FIXED_BYTES]),
            Err(WrongOrigin::Name(_))
        ));
        assert_eq!(Origin::decode(&[2; 30]), Err(WrongOrigin::Version(2)));
        let text = [&bytes[..FIXED_BYTES], &[0xff]].concat();
        assert_eq!(Origin::decode(&text), Err(WrongOrigin::Text));
    }
}
