//! A message that must not be lost.

use bytes::Bytes;
use sm2_node::clock::wall_time;
use sm2_node::{Sample, now};
use sm2_proto::{Name, TypeId};

use crate::Origin;
use crate::domain::Topic;

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

impl Durable {
    /// A copy of a message of the domain.
    #[must_use]
    pub fn new((topic, data): &Topic, origin: &Origin, sample: &Sample<[u8]>) -> Self {
        Self {
            topic: topic.clone(),
            data: data.clone(),
            origin: origin.clone(),
            time: publication_time(sample),
            payload: Bytes::copy_from_slice(sample),
        }
    }
}

/// The time when a message was published, in nanoseconds since 1970 (UTC).
#[must_use]
pub fn publication_time(sample: &Sample<[u8]>) -> u64 {
    let age = now().since(sample.source_time()).as_nanos();
    let age = u64::try_from(age).unwrap_or(u64::MAX);
    wall_time().0.saturating_sub(age)
}
