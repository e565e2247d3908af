//! Identifiers of gateways, offers, questions and streams.

use core::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

/// The id of a gateway: an Ed25519 public key. A process that has the private key is the gateway.
//= SM2-GWC-001
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct GatewayId(pub [u8; 32]);

/// The reason why a text is not a [`GatewayId`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GatewayIdError {
    /// The text does not have 64 bytes.
    #[error("the id of a gateway has 64 hexadecimal digits, this text has {0} bytes")]
    Length(usize),
    /// The byte at this offset is not a lower-case hexadecimal digit.
    #[error("the id of a gateway has only the digits 0-9 and a-f; byte {0} is another")]
    BadByte(usize),
}

/// The number of an offer. The side that makes the offer chooses it; numbers grow from 1.
//= SM2-GWO-001
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct OfferId(pub u64);

/// The number of a question (ASK). The side that asks chooses it freely.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct AskId(pub u64);

/// The driver's identifier of a stream within one connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StreamToken(pub u64);

impl fmt::Display for GatewayId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for GatewayId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "GatewayId({self})")
    }
}

impl FromStr for GatewayId {
    type Err = GatewayIdError;

    fn from_str(text: &str) -> Result<Self, GatewayIdError> {
        let text = text.as_bytes();
        if text.len() != 64 {
            return Err(GatewayIdError::Length(text.len()));
        }
        let digit = |at: usize| match text[at] {
            it @ b'0'..=b'9' => Ok(it - b'0'),
            it @ b'a'..=b'f' => Ok(it - b'a' + 10),
            _ => Err(GatewayIdError::BadByte(at)),
        };
        let mut bytes = [0; 32];
        for (at, byte) in bytes.iter_mut().enumerate() {
            *byte = digit(2 * at)? << 4 | digit(2 * at + 1)?;
        }
        Ok(Self(bytes))
    }
}
