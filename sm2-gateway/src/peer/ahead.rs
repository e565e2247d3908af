//! An estimate of the bytes that were written to QUIC and not sent yet.
//!
//! Newer messages cannot overtake bytes that QUIC already holds, so QUIC is given only enough bytes
//! to keep it busy until the next call. QUIC does not report how many bytes it has not sent. The
//! estimate adds the written bytes and the lost bytes, which are sent again, and subtracts the
//! bytes that datagrams carried. It assumes headers that are slightly too long, so it errs on the
//! high side. As a result QUIC runs out of bytes from time to time and reports that, and the
//! estimate restarts at zero.

use quinn_proto::{Connection, Transmit};
use sm2_io::quic::app_limited_acks;

/// The least amount that QUIC is given, in datagrams.
const LEAST_DATAGRAMS: u64 = 16;
/// In addition, QUIC is given this part of the congestion window.
const WINDOW_DIVISOR: u64 = 16;
/// The length of the headers of a datagram and its STREAM frame: 36 to 44 bytes (RFC 9000, 17.3 and 19.8).
const HEADERS_BYTES: u64 = 44;

/// Payloads up to this length are short. QUIC sends them before long ones that it has already, so they
/// may use `SPARE_BYTES` more room.
pub(super) const SHORT_BYTES: usize = 16 << 10;
/// The additional room for short payloads.
const SPARE_BYTES: usize = 16 << 10;

/// The estimate of one connection.
#[derive(Debug, Default)]
pub(super) struct Ahead {
    unsent_bytes: u64,
    /// The bytes that were lost so far.
    lost_bytes: u64,
    /// How often QUIC has reported that it had nothing to send.
    app_limited_acks: u64,
}

impl Ahead {
    /// How much may be written now.
    pub(super) fn room(&mut self, connection: &Connection) -> Room {
        let lost_bytes = connection.stats().path.lost_bytes;
        self.unsent_bytes += lost_bytes.saturating_sub(self.lost_bytes);
        self.lost_bytes = lost_bytes;
        let app_limited_acks = app_limited_acks(connection);
        if app_limited_acks != self.app_limited_acks {
            self.app_limited_acks = app_limited_acks;
            self.unsent_bytes = 0;
        }
        let window = connection.congestion_state().window();
        let most = most_bytes(connection.current_mtu(), window);
        let left = most.saturating_sub(self.unsent_bytes);
        Room {
            left_bytes: usize::try_from(left).unwrap_or(usize::MAX),
            taken_bytes: 0,
        }
    }

    /// Adds what was written. True if anything was.
    pub(super) const fn wrote(&mut self, room: &Room) -> bool {
        self.unsent_bytes += room.taken_bytes as u64;
        room.taken_bytes > 0
    }

    /// Subtracts what datagrams carried.
    pub(super) fn sent(&mut self, transmit: &Transmit) {
        let datagrams = transmit
            .segment_size
            .map_or(1, |it| transmit.size.div_ceil(it));
        let carried = (transmit.size as u64).saturating_sub(datagrams as u64 * HEADERS_BYTES);
        self.unsent_bytes = self.unsent_bytes.saturating_sub(carried);
    }
}

/// How much QUIC may hold that it has not sent, with this length of datagrams and this congestion window.
const fn most_bytes(mtu: u16, window_bytes: u64) -> u64 {
    let least = mtu as u64 * LEAST_DATAGRAMS;
    least + window_bytes / WINDOW_DIVISOR + SPARE_BYTES as u64
}

/// How much may be written.
#[derive(Debug)]
pub(super) struct Room {
    left_bytes: usize,
    taken_bytes: usize,
}

impl Room {
    /// The bytes that may be written of a payload of this length.
    pub(super) fn left(&self, len_bytes: usize) -> usize {
        match len_bytes {
            ..=SHORT_BYTES => self.left_bytes,
            _ => self.left_bytes.saturating_sub(SPARE_BYTES),
        }
    }

    /// Counts bytes that were written.
    pub(super) fn take(&mut self, len_bytes: usize) {
        self.left_bytes = self.left_bytes.saturating_sub(len_bytes);
        self.taken_bytes += len_bytes;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quic_holds_some_datagrams_and_a_part_of_the_window() {
        assert_eq!(most_bytes(1_200, 0), 19_200 + (16 << 10));
        assert_eq!(most_bytes(1_200, 160_000) - most_bytes(1_200, 0), 10_000);
    }
}
