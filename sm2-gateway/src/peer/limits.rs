//! The resources that a connection may use and that it uses.

/// The limits of the memory that a peer, or a process of the domain, can occupy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The greatest length of a payload, from a peer or from the domain. A longer one is refused.
    pub message_bytes: u64,
    /// The greatest sum of the lengths of payloads that have not arrived completely; of messages for
    /// the peer; and of requests and replies for the peer.
    pub memory_bytes: u64,
    /// The greatest sum of all these bytes of all peers. Each connected peer has an equal part.
    pub gateway_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            message_bytes: 64 << 20,
            memory_bytes: 128 << 20,
            gateway_bytes: 512 << 20,
        }
    }
}

/// The streams, payloads and calls of a connection that are not complete.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Streams of the peer for control frames and calls.
    pub bidirectional_streams: u64,
    /// Streams of the peer for messages.
    pub unidirectional_streams: u64,
    /// Payloads that have not arrived completely.
    pub payloads: usize,
    /// Calls without a reply in both directions, and requests and replies that are not written
    /// completely.
    pub calls: usize,
}
