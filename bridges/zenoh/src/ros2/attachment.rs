//! The attachments of messages, as rmw_zenoh writes and reads them.
//!
//! The sequence number and the time of the publication (nanoseconds since 1970, UTC) in 8 bytes each (little-endian),
//! the number 16, and the 16 bytes of the GID. A bridge appends its [`Origin`], which rmw_zenoh does not read.

use sm2_bridge_core::{Delivery, Origin};

/// The number that identifies a publisher.
pub(crate) type Gid = [u8; 16];

/// The length of an attachment without an origin, in bytes.
const FIXED_BYTES: usize = 8 + 8 + 1 + 16;

/// The attachment of the message with the number of `origin`.
pub(crate) fn encode(
    source_time_ns: u64,
    gid: &Gid,
    origin: &Origin,
    delivery: Delivery,
) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(FIXED_BYTES);
    bytes.extend(origin.number.to_le_bytes());
    bytes.extend(source_time_ns.to_le_bytes());
    bytes.push(16);
    bytes.extend(gid);
    bytes.extend(origin.encode(delivery));
    bytes
}

/// The attachment of a reply: that of the call, with another time.
pub(crate) fn reply(call: &[u8], source_time_ns: u64) -> Vec<u8> {
    let mut bytes = call.get(..FIXED_BYTES).unwrap_or_default().to_vec();
    if let Some(time) = bytes.get_mut(8..16) {
        time.copy_from_slice(&source_time_ns.to_le_bytes());
    }
    bytes
}

/// The origin of a message. `None` if no bridge has put it into the network.
pub(crate) fn origin(bytes: &[u8]) -> Option<(Origin, Delivery)> {
    Origin::decode(bytes.get(FIXED_BYTES..)?).ok()
}

#[cfg(test)]
mod tests {
    use sm2_proto::Name;

    use super::*;

    #[test]
    fn an_attachment_has_the_fields_of_rmw_zenoh_and_the_origin() {
        let it = Origin {
            bridge: Name::new("seven").unwrap(),
            epoch: 1,
            number: 2,
        };
        let bytes = encode(3, &[4; 16], &it, Delivery::BesideGateway);
        assert_eq!(
            bytes[..17],
            [2, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 16]
        );
        assert_eq!(bytes[17..33], [4; 16]);
        assert_eq!(origin(&bytes), Some((it, Delivery::BesideGateway)));
        assert_eq!(origin(&bytes[..33]), None);
        assert_eq!(origin(&bytes[..5]), None);
        let reply = reply(&bytes, 9);
        assert_eq!(
            (&reply[..8], &reply[8..16]),
            (&bytes[..8], &[9, 0, 0, 0, 0, 0, 0, 0][..])
        );
        assert_eq!(reply[16..], bytes[16..33]);
        assert!(super::reply(&bytes[..5], 9).is_empty());
    }
}
