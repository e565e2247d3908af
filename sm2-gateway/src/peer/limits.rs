//! The resources that a connection may use and that it uses.

use std::fmt;

use serde::{Deserialize, Serialize};
use sm2_proto::limits::MESSAGE_MAX;

/// The limits of the memory that a peer, or a process of the domain, can occupy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct Limits {
    /// The greatest length of a payload, from a peer or from the domain. A longer one is refused.
    pub message_bytes: u64,
    /// The greatest sum of the lengths of payloads that have not arrived completely, and of messages, requests and
    /// replies for the peer that the peer has not acknowledged.
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

/// A limit of a gateway: a key of the table `[limits]` of its configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// [`Limits::message_bytes`].
    MessageBytes,
    /// [`Limits::memory_bytes`].
    MemoryBytes,
    /// [`Limits::gateway_bytes`].
    GatewayBytes,
}

impl Limit {
    /// Every limit. Each one may be at most the next one.
    pub const ALL: [Self; 3] = [Self::MessageBytes, Self::MemoryBytes, Self::GatewayBytes];

    /// The key of the configuration.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::MessageBytes => "message_bytes",
            Self::MemoryBytes => "memory_bytes",
            Self::GatewayBytes => "gateway_bytes",
        }
    }

    /// The greatest value.
    #[must_use]
    pub const fn most(self) -> u64 {
        match self {
            Self::MessageBytes => MESSAGE_MAX,
            // The largest number of TOML.
            Self::MemoryBytes | Self::GatewayBytes => i64::MAX as u64,
        }
    }

    /// The limit of a sum that contains the bytes of this one.
    #[must_use]
    pub const fn whole(self) -> Option<Self> {
        match self {
            Self::MessageBytes => Some(Self::MemoryBytes),
            Self::MemoryBytes => Some(Self::GatewayBytes),
            Self::GatewayBytes => None,
        }
    }
}

/// `greatest length of a message, request or reply`.
impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::MessageBytes => "greatest length of a message, request or reply",
            Self::MemoryBytes => {
                "greatest sum, for each peer, of payloads that are arriving, and of messages, requests and replies \
                 that the peer has not acknowledged"
            }
            Self::GatewayBytes => {
                "greatest sum of all these bytes of all peers; each connected peer has an equal part"
            }
        })
    }
}

impl Limits {
    /// The value of a limit.
    #[must_use]
    pub const fn of(&self, limit: Limit) -> u64 {
        match limit {
            Limit::MessageBytes => self.message_bytes,
            Limit::MemoryBytes => self.memory_bytes,
            Limit::GatewayBytes => self.gateway_bytes,
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
