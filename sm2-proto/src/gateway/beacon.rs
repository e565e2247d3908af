//! Beacons, the datagrams that let gateways find each other: SPEC section 14.7.

use super::GatewayId;

/// The length of a beacon in bytes.
pub const BEACON_LEN: usize = 56;

const MAGIC: [u8; 4] = *b"SM2G";
const VERSION: u16 = 1;

/// A hint that a gateway may be found at the address that the datagram came from. Nothing in a
/// beacon is proven: anybody can send one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Beacon {
    /// The UDP port of QUIC; not 0.
    pub port: u16,
    /// The id that the sender claims to have.
    pub gateway: GatewayId,
    /// The epoch of the process: greater than that of any earlier process with the same key.
    pub epoch: u64,
}

/// The reason why a datagram is not a beacon, and is ignored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BeaconError {
    /// The length is not [`BEACON_LEN`].
    #[error("a beacon has {BEACON_LEN} bytes")]
    Length,
    /// The magic number is missing.
    #[error("a beacon begins with SM2G")]
    Magic,
    /// The version is unknown.
    #[error("beacons of version {0} are unknown")]
    Version(u16),
    /// The port is 0.
    #[error("a beacon names a port other than 0")]
    NoPort,
    /// A reserved byte is not zero.
    #[error("the last 8 bytes of a beacon are zeros")]
    ReservedNotZero,
}

impl Beacon {
    /// Encodes the beacon.
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

    /// Decodes a datagram that was sent to the multicast group.
    ///
    /// # Errors
    /// The datagram is not exactly a beacon.
    //= SM2-GWD-001
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, BeaconError> {
        let bytes: &[u8; BEACON_LEN] = bytes.try_into().map_err(|_| BeaconError::Length)?;
        if field(bytes, 0) != MAGIC {
            return Err(BeaconError::Magic);
        }
        let version = u16::from_le_bytes(field(bytes, 4));
        if version != VERSION {
            return Err(BeaconError::Version(version));
        }
        let port = u16::from_le_bytes(field(bytes, 6));
        if port == 0 {
            return Err(BeaconError::NoPort);
        }
        if field(bytes, 48) != [0; 8] {
            return Err(BeaconError::ReservedNotZero);
        }
        Ok(Self {
            port,
            gateway: GatewayId(field(bytes, 8)),
            epoch: u64::from_le_bytes(field(bytes, 40)),
        })
    }
}

/// The `N` bytes at offset `at`.
fn field<const N: usize>(bytes: &[u8; BEACON_LEN], at: usize) -> [u8; N] {
    core::array::from_fn(|index| bytes[at + index])
}
