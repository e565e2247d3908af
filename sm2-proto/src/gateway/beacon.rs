//! The datagram by which a gateway can be found: SPEC section 14.7.

use super::GatewayId;

/// The bytes of a beacon.
pub const BEACON_LEN: usize = 56;

const MAGIC: [u8; 4] = *b"SM2G";
const VERSION: u16 = 1;

/// A hint where a gateway may be found, at the address that it came from: anybody can send one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Beacon {
    /// The port of QUIC; not 0.
    pub port: u16,
    /// Who it says that it is.
    pub gateway: GatewayId,
    /// Of its process: greater than those of all before with its key.
    pub epoch: u64,
}

/// Why a datagram is ignored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoBeacon {
    /// It has another length than [`BEACON_LEN`].
    #[error("a beacon has {BEACON_LEN} bytes")]
    Length,
    /// It does not begin as beacons do.
    #[error("a beacon begins with SM2G")]
    Magic,
    /// It is of another version.
    #[error("beacons of version {0} are not known")]
    Version(u16),
    /// It names no port.
    #[error("a beacon names a port")]
    NoPort,
    /// Bytes that have to be zero are not.
    #[error("the last 8 bytes of a beacon are zeros")]
    ReservedNotZero,
}

impl Beacon {
    /// As it is sent.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; BEACON_LEN] {
        let mut bytes = [0; BEACON_LEN];
        bytes[..4].copy_from_slice(&MAGIC);
        bytes[4..6].copy_from_slice(&VERSION.to_le_bytes());
        bytes[6..8].copy_from_slice(&self.port.to_le_bytes());
        bytes[8..40].copy_from_slice(&self.gateway.0);
        bytes[40..48].copy_from_slice(&self.epoch.to_le_bytes());
        bytes
    }

    /// Reads a datagram that came to the group.
    ///
    /// # Errors
    /// It is not exactly a beacon.
    //= SM2-GWD-001
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, NoBeacon> {
        let bytes: &[u8; BEACON_LEN] = bytes.try_into().map_err(|_| NoBeacon::Length)?;
        if field(bytes, 0) != MAGIC {
            return Err(NoBeacon::Magic);
        }
        let version = u16::from_le_bytes(field(bytes, 4));
        if version != VERSION {
            return Err(NoBeacon::Version(version));
        }
        let port = u16::from_le_bytes(field(bytes, 6));
        if port == 0 {
            return Err(NoBeacon::NoPort);
        }
        if field(bytes, 48) != [0; 8] {
            return Err(NoBeacon::ReservedNotZero);
        }
        Ok(Self {
            port,
            gateway: GatewayId(field(bytes, 8)),
            epoch: u64::from_le_bytes(field(bytes, 40)),
        })
    }
}

/// The bytes from `at` on.
fn field<const N: usize>(bytes: &[u8; BEACON_LEN], at: usize) -> [u8; N] {
    core::array::from_fn(|index| bytes[at + index])
}
