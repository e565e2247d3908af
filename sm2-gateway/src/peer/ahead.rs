//! How much QUIC was given that it has not sent yet.
//!
//! What it has cannot be overtaken by anything newer, so it is to have little: as much as keeps it busy until
//! it is asked again. QUIC does not say what it has. It is counted here: what is written, and what was lost
//! and will be sent again, less what datagrams carried. Their headers are counted a little too long,
//! so that the count is rather too high: then QUIC has nothing left for a moment, says so, and the count
//! begins anew.

use quinn_proto::{Connection, Transmit};
use sm2_io::quic::idle_acks;

/// Datagrams that QUIC has ahead at least.
const LEAST_DATAGRAMS: u64 = 16;
/// And this part of what may be under way.
const WINDOW_DIVISOR: u64 = 16;
/// The headers of a datagram and of what is in it, in bytes: 36 to 44 (RFC 9000, 17.3 and 19.8).
const HEADERS_BYTES: u64 = 44;

/// Payloads up to this length are short: QUIC sends them before longer ones that it has already, so that
/// they do not wait until it has less ahead.
pub(super) const SHORT_BYTES: usize = 16 << 10;
/// What it may have ahead of these beside.
const SPARE_BYTES: usize = 16 << 10;

/// What QUIC has ahead of one connection.
#[derive(Debug, Default)]
pub(super) struct Ahead {
    unsent_bytes: u64,
    /// What was lost so far.
    lost_bytes: u64,
    idle_acks: u64,
}

impl Ahead {
    /// How much can be written now.
    pub(super) fn room(&mut self, connection: &Connection) -> Room {
        let lost_bytes = connection.stats().path.lost_bytes;
        self.unsent_bytes += lost_bytes.saturating_sub(self.lost_bytes);
        self.lost_bytes = lost_bytes;
        let idle_acks = idle_acks(connection);
        if idle_acks != self.idle_acks {
            self.idle_acks = idle_acks;
            self.unsent_bytes = 0;
        }
        let window = connection.congestion_state().window();
        let least = u64::from(connection.current_mtu()) * LEAST_DATAGRAMS;
        let most = least + window / WINDOW_DIVISOR + SPARE_BYTES as u64;
        let left = most.saturating_sub(self.unsent_bytes);
        Room {
            left_bytes: usize::try_from(left).unwrap_or(usize::MAX),
            taken_bytes: 0,
        }
    }

    /// Whether anything was.
    pub(super) const fn wrote(&mut self, room: &Room) -> bool {
        self.unsent_bytes += room.taken_bytes as u64;
        room.taken_bytes > 0
    }

    pub(super) fn sent(&mut self, transmit: &Transmit) {
        let datagrams = transmit
            .segment_size
            .map_or(1, |it| transmit.size.div_ceil(it));
        let carried = (transmit.size as u64).saturating_sub(datagrams as u64 * HEADERS_BYTES);
        self.unsent_bytes = self.unsent_bytes.saturating_sub(carried);
    }
}

/// How much can be written.
#[derive(Debug)]
pub(super) struct Room {
    left_bytes: usize,
    taken_bytes: usize,
}

impl Room {
    /// In bytes, of a payload of this length.
    pub(super) fn left(&self, len_bytes: usize) -> usize {
        match len_bytes {
            ..=SHORT_BYTES => self.left_bytes,
            _ => self.left_bytes.saturating_sub(SPARE_BYTES),
        }
    }

    pub(super) fn take(&mut self, len_bytes: usize) {
        self.left_bytes = self.left_bytes.saturating_sub(len_bytes);
        self.taken_bytes += len_bytes;
    }
}
