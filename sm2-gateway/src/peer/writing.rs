//! What is written to streams.

use bytes::Bytes;
use quinn_proto::WriteError;
use sm2_proto::gateway::{
    PeerFarewell,
    session::{Input, PeerEvent},
};

use super::Peer;
use crate::clock::Now;

/// How much of the control stream waits for a peer that does not read it.
const CONTROL_WAITING_MAX: usize = 1 << 20;

impl Peer {
    /// Gives QUIC a little more than it can send at once; whether anything.
    pub(super) fn write(&mut self, now: Now) -> bool {
        // How much room there is takes some looking: not for those who only receive.
        if self.is_over || (self.calls.is_idle() && self.topics.is_idle()) {
            return false;
        }
        let mut room = self.ahead.room(&self.connection);
        (self.calls).write(&mut self.connection, &mut room, &mut self.tally);
        let (topics, mut outlet) = self.topics(now);
        topics.write(&mut outlet, &mut room);
        self.ahead.wrote(&room)
    }

    pub(super) fn write_control(&mut self, now: Now) {
        let Some(id) = self.control else { return };
        let mut stream = self.connection.send_stream(id);
        // Before all messages.
        let _ = stream.set_priority(2);
        while let Some(bytes) = self.control_out.front_mut() {
            match stream.write_chunks(std::slice::from_mut(bytes)) {
                Ok(_) if bytes.is_empty() => {
                    self.control_out.pop_front();
                }
                Ok(_) | Err(WriteError::Blocked) => break,
                Err(WriteError::Stopped(_) | WriteError::ClosedStream) => {
                    self.session_event(now, PeerEvent::Closed(None));
                    return;
                }
            }
        }
        let waiting: usize = self.control_out.iter().map(Bytes::len).sum();
        if waiting > CONTROL_WAITING_MAX {
            self.session_takes(now, Input::Close(PeerFarewell::Stalled.code()));
        }
    }
}
