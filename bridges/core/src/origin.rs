//! The origin of a message.

use sm2_proto::{Name, NameError};

/// The first byte of the attachment, which has the delivery.
const AT_MOST_ONCE: u8 = 1;
const AT_LEAST_ONCE: u8 = 2;
const BESIDE_GATEWAY: u8 = 3;
/// The length of the attachment without the name, in bytes.
const FIXED_BYTES: usize = 1 + 8 + 8;

/// The bridge that has put a message into the network, and the number of the message.
///
/// As an attachment: a byte for the [`Delivery`], the epoch and the number in 8 bytes each (little-endian), and the
/// name.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Origin {
    /// The name of the bridge.
    pub bridge: Name,
    /// The time when the bridge began with the topic, in nanoseconds since 1970 (UTC).
    pub epoch: u64,
    /// The number of the message, counted by its bridge since then.
    pub number: u64,
}

/// The origins of the messages of one bridge.
#[derive(Clone, Debug)]
pub struct Origins {
    bridge: Name,
    last_epoch: u64,
}

impl Origins {
    /// The origins of the bridge with this name.
    #[must_use]
    pub const fn new(bridge: Name) -> Self {
        Self {
            bridge,
            last_epoch: 0,
        }
    }

    /// The origin before the first message of a topic. `wall` is the present time, in nanoseconds since 1970 (UTC).
    ///
    /// No two calls return the same epoch: numbers begin anew when a topic comes again, and its messages are no
    /// duplicates of those before.
    pub fn begin(&mut self, wall: u64) -> Origin {
        self.last_epoch = wall.max(self.last_epoch + 1);
        Origin {
            bridge: self.bridge.clone(),
            epoch: self.last_epoch,
            number: 0,
        }
    }
}

/// Whether the bridge that has put a message into the network waits for an acknowledgement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// It does not. In an attachment: 1.
    AtMostOnce,
    /// It sends the message until a bridge has acknowledged it. In an attachment: 2.
    AtLeastOnce,
    /// It does not, and a gateway of its domain carries the topic, too. In an attachment: 3.
    BesideGateway,
}

/// The reason why an attachment is not an [`Origin`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WrongOrigin {
    /// It is too short.
    #[error("an origin has more than {FIXED_BYTES} bytes, this attachment has {0}")]
    Short(usize),
    /// It is of another version.
    #[error("an origin begins with 1, 2 or 3, this attachment begins with {0}")]
    Version(u8),
    /// The name is not UTF-8.
    #[error("the name of the bridge is not UTF-8")]
    Text,
    /// The name is not a legal name.
    #[error("the name of the bridge is wrong: {0}")]
    Name(NameError),
}

impl Origin {
    /// The attachment.
    #[must_use]
    pub fn encode(&self, delivery: Delivery) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(FIXED_BYTES + self.bridge.as_str().len());
        bytes.push(match delivery {
            Delivery::AtMostOnce => AT_MOST_ONCE,
            Delivery::AtLeastOnce => AT_LEAST_ONCE,
            Delivery::BesideGateway => BESIDE_GATEWAY,
        });
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
    pub fn decode(bytes: &[u8]) -> Result<(Self, Delivery), WrongOrigin> {
        let short = WrongOrigin::Short(bytes.len());
        let (version, rest) = bytes.split_first().ok_or(short)?;
        let delivery = match *version {
            AT_MOST_ONCE => Delivery::AtMostOnce,
            AT_LEAST_ONCE => Delivery::AtLeastOnce,
            BESIDE_GATEWAY => Delivery::BesideGateway,
            other => return Err(WrongOrigin::Version(other)),
        };
        let (epoch, rest) = rest.split_first_chunk().ok_or(short)?;
        let (number, name) = rest.split_first_chunk().ok_or(short)?;
        let name = str::from_utf8(name).map_err(|_| WrongOrigin::Text)?;
        let origin = Self {
            bridge: Name::new(name).map_err(WrongOrigin::Name)?,
            epoch: u64::from_le_bytes(*epoch),
            number: u64::from_le_bytes(*number),
        };
        Ok((origin, delivery))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_topics_have_the_same_epoch() {
        let mut origins = Origins::new(Name::new("robot").unwrap());
        // The clock stands still, and steps back.
        let epochs = [7, 7, 3, 20].map(|wall| origins.begin(wall).epoch);
        assert_eq!(epochs, [7, 8, 9, 20]);
    }

    #[test]
    fn an_origin_comes_back_and_nothing_else_is_one() {
        let origin = Origin {
            bridge: Name::new("robot/7").unwrap(),
            epoch: 1 << 60,
            number: u64::MAX,
        };
        for delivery in [Delivery::AtLeastOnce, Delivery::BesideGateway] {
            let bytes = origin.encode(delivery);
            let expected = (origin.clone(), delivery);
            assert_eq!(Origin::decode(&bytes), Ok(expected));
        }
        let bytes = origin.encode(Delivery::AtMostOnce);
        assert_eq!(Origin::decode(&bytes), Ok((origin, Delivery::AtMostOnce)));
        for len in 0..FIXED_BYTES {
            assert_eq!(Origin::decode(&bytes[..len]), Err(WrongOrigin::Short(len)));
        }
        assert!(matches!(
            Origin::decode(&bytes[..FIXED_BYTES]),
            Err(WrongOrigin::Name(_))
        ));
        assert_eq!(Origin::decode(&[4; 30]), Err(WrongOrigin::Version(4)));
        let text = [&bytes[..FIXED_BYTES], &[0xff]].concat();
        assert_eq!(Origin::decode(&text), Err(WrongOrigin::Text));
    }
}
