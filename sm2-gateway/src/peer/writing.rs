//! Writing to streams.

use bytes::Bytes;
use quinn_proto::WriteError;
use sm2_proto::gateway::{
    PeerFarewell,
    session::{self, PeerEvent},
};

use super::{Peer, outlet::Outlet, phase::Phase};
use crate::clock::Now;

/// The greatest number of control bytes that wait for a peer that does not read them.
const CONTROL_WAITING_MAX: usize = 1 << 20;

impl Peer {
    /// Gives QUIC slightly more than it can send at once. True if anything was written.
    pub(super) fn write(&mut self, now: Now) -> bool {
        // Determining the room costs time, which a connection that only receives saves.
        if self.phase.is_over() || (self.calls.is_idle() && self.topics.is_idle()) {
            return false;
        }
        let mut room = self.ahead.room(&self.connection);
        let mut outlet = Outlet {
            now: now.at,
            connection: &mut self.connection,
            tally: &mut self.tally,
            unacked: &mut self.unacked,
            gate: self.gate.as_ref(),
        };
        self.calls.write(&mut outlet, &mut room);
        self.topics.write(&mut outlet, &mut room);
        self.ahead.wrote(&room)
    }

    pub(super) fn write_control(&mut self, now: Now) {
        let Phase::Session(open) = &mut self.phase else {
            return;
        };
        let Some(id) = open.control else { return };
        let mut stream = self.connection.send_stream(id);
        // Before calls, which have priority 1, and messages, which have 0 or less.
        let _ = stream.set_priority(2);
        while let Some(bytes) = open.control_out.front_mut() {
            match stream.write_chunks(std::slice::from_mut(bytes)) {
                Ok(_) if bytes.is_empty() => {
                    open.control_out.pop_front();
                }
                Ok(_) | Err(WriteError::Blocked) => break,
                Err(WriteError::Stopped(_) | WriteError::ClosedStream) => {
                    self.session_event(now, PeerEvent::Closed(None));
                    return;
                }
            }
        }
        let waiting: usize = open.control_out.iter().map(Bytes::len).sum();
        //= SM2-GWF-003
        if waiting > CONTROL_WAITING_MAX {
            self.session_takes(now, session::Input::Close(PeerFarewell::Stalled.code()));
        }
    }
}
