//! The limit that a publisher sets for the memory of its messages.
//!
//! The default of a publisher, 256 MiB, is some seconds of large messages for subscribers that lag, and a small part of
//! the memory of a robot's computer. If its messages are long, the default is 24 of them, twice the window of a
//! subscriber with the default options.

use crate::pool::{POOL_LIMIT_BYTES, POOL_LIMIT_MESSAGES, stride_for};

/// How much memory the messages of an interface may use, in addition to reserved memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PoolLimit {
    bytes: u64,
    /// There is always memory for this many messages of the longest length so far.
    messages: u64,
}

impl PoolLimit {
    /// No limit, for interfaces whose messages the limit of calls bounds.
    pub(crate) const NONE: Self = Self::bytes(u64::MAX);

    /// A limit that the program set.
    pub(crate) const fn bytes(bytes: u64) -> Self {
        Self { bytes, messages: 0 }
    }

    /// The limit of a publisher that sets none and keeps this many messages for later subscribers.
    pub(crate) const fn default_with(latched: u16) -> Self {
        Self {
            bytes: POOL_LIMIT_BYTES,
            messages: POOL_LIMIT_MESSAGES + latched as u64,
        }
    }

    /// The limit while messages of this length are sent.
    pub(super) const fn bytes_for(self, len: u64) -> u64 {
        let least = self.messages.saturating_mul(stride_for(len));
        if least > self.bytes {
            least
        } else {
            self.bytes
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_has_room_for_24_messages_beside_the_latched_ones() {
        let len = 64 << 20;
        let slot = stride_for(len);
        for (latched, messages) in [(0, 24), (1, 25), (10, 34)] {
            let limit = PoolLimit::default_with(latched);
            assert_eq!(limit.bytes_for(len), messages * slot, "{latched}");
            assert_eq!(limit.bytes_for(1), POOL_LIMIT_BYTES);
        }
        // A limit of the program holds for messages of each length.
        assert_eq!(PoolLimit::bytes(5).bytes_for(len), 5);
    }
}
