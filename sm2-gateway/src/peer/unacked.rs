//! The payloads that are written completely and that QUIC still holds.
//!
//! QUIC sends lost bytes again, so it holds the bytes that the peer has not acknowledged. They are parts of payloads
//! that were not copied, so one byte keeps its whole payload in memory.

use std::collections::BTreeMap;

use quinn_proto::StreamId;

/// The payloads of one connection.
#[derive(Debug, Default)]
pub(super) struct Unacked {
    lens: BTreeMap<StreamId, u64>,
    bytes: u64,
}

impl Unacked {
    /// The payload of a stream is written.
    pub(super) fn add(&mut self, id: StreamId, len_bytes: usize) {
        let before = self.lens.insert(id, len_bytes as u64);
        debug_assert!(before.is_none(), "a stream has one payload");
        self.bytes += len_bytes as u64;
    }

    /// The stream is acknowledged or reset: QUIC holds nothing of it any more.
    pub(super) fn remove(&mut self, id: StreamId) {
        self.bytes -= self.lens.remove(&id).unwrap_or(0);
    }

    /// The sum of the lengths.
    pub(super) const fn bytes(&self) -> u64 {
        self.bytes
    }
}
