//! A message that must not be lost.

use bytes::Bytes;
use sm2_proto::{Name, TypeId};

use crate::Origin;

/// A message of a durable topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Durable {
    /// The topic in the domain.
    pub topic: Name,
    /// The type of the payload.
    pub data: TypeId,
    /// The bridge that has taken it from its domain, and its number. A message keeps it when the bridge starts anew.
    pub origin: Origin,
    /// The time of publication, in nanoseconds since 1970 (UTC).
    pub time: u64,
    /// The payload.
    pub payload: Bytes,
}
