//! A gateway's key pair, which is its identity.

use std::fmt;

use ring::{
    rand::SystemRandom,
    signature::{Ed25519KeyPair, KeyPair},
};
use sm2_proto::gateway::GatewayId;

/// The DER header before the 32 bytes of an Ed25519 public key (RFC 8410).
const SPKI_HEAD: [u8; 12] = [
    0x30, 0x2a, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x03, 0x21, 0x00,
];

/// An Ed25519 private key. Its holder is the gateway.
//= SM2-GWC-001
#[derive(Clone)]
pub struct SecretKey {
    pkcs8: Vec<u8>,
    id: GatewayId,
}

/// Why a key cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// The bytes are not an Ed25519 private key.
    #[error("not an Ed25519 private key in PKCS#8 form")]
    NoKey,
    /// The operating system provides no random numbers.
    #[error("the operating system provides no random numbers")]
    NoRandom,
}

impl SecretKey {
    /// Generates a new key.
    ///
    /// # Errors
    /// The operating system provides no random numbers.
    pub fn generate() -> Result<Self, KeyError> {
        let pkcs8 = Ed25519KeyPair::generate_pkcs8(&SystemRandom::new());
        Self::from_pkcs8(pkcs8.map_err(|_| KeyError::NoRandom)?.as_ref())
    }

    /// Reads a key in PKCS#8 form (RFC 5958), as in a key file.
    ///
    /// # Errors
    /// The bytes are not such a key.
    pub fn from_pkcs8(pkcs8: &[u8]) -> Result<Self, KeyError> {
        let pair = Ed25519KeyPair::from_pkcs8_maybe_unchecked(pkcs8);
        let pair = pair.map_err(|_| KeyError::NoKey)?;
        let id = pair.public_key().as_ref().try_into();
        Ok(Self {
            pkcs8: pkcs8.to_vec(),
            id: GatewayId(id.map_err(|_| KeyError::NoKey)?),
        })
    }

    /// The key in PKCS#8 form, for a key file.
    #[must_use]
    pub fn to_pkcs8(&self) -> &[u8] {
        &self.pkcs8
    }

    /// The public key.
    #[must_use]
    pub const fn id(&self) -> GatewayId {
        self.id
    }
}

impl fmt::Debug for SecretKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SecretKey")
            .field("id", &self.id)
            .finish_non_exhaustive()
    }
}

/// A public key in the form that TLS presents (RFC 7250).
pub(super) fn to_spki(id: GatewayId) -> Vec<u8> {
    [&SPKI_HEAD[..], &id.0].concat()
}

/// The gateway whose public key this is; `None` if it is not an Ed25519 key.
pub(super) fn from_spki(der: &[u8]) -> Option<GatewayId> {
    let key = der.strip_prefix(&SPKI_HEAD)?;
    key.try_into().ok().map(GatewayId)
}
