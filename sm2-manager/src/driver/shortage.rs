//! Shortage: of descriptors, because the process has too many open or too many are in flight, and of memory.

use std::{io, time::Duration};

use nix::libc;
use sm2_io::{SeqPacket, clock};
use sm2_proto::NodeId;
use tracing::warn;

use super::{Manager, log_limit::Warning};

/// How many descriptors may be queued for one node during a shortage. A node that is busy for a moment stays
/// below.
const HOARD: usize = 64;
/// How many descriptors a node may have left unread while too many are in flight. A node that is busy for a
/// moment stays below.
const UNREAD: usize = 32;
/// How long sending pauses when too many descriptors are in flight, or when memory is short.
const SEND_PAUSE: Duration = Duration::from_millis(10);

impl Manager {
    /// Creates the socket pair of a link.
    pub(super) fn pair(&mut self) -> io::Result<(SeqPacket, SeqPacket)> {
        loop {
            match SeqPacket::pair() {
                Err(error) if self.make_descriptors(&error) => {}
                result => return result,
            }
        }
    }

    /// If the process is out of descriptors, gives up the node with the most queued descriptors, so that a
    /// node that does not read cannot block the others. Returns whether descriptors were freed.
    //= SM2-TRN-008
    pub(super) fn make_descriptors(&mut self, error: &io::Error) -> bool {
        let short = [libc::EMFILE, libc::ENFILE].map(Some);
        if !short.contains(&error.raw_os_error()) {
            return false;
        }
        let all = self.connections.iter_mut();
        let most = all.max_by_key(|(_, connection)| connection.waiting_fds());
        let Some((&session, hoarder)) = most else {
            return false;
        };
        if hoarder.waiting_fds() <= HOARD {
            return false;
        }
        hoarder.give_up();
        self.given_up.push_back(session);
        true
    }

    /// Pauses sending because the kernel is short of memory.
    //= SM2-TRN-012
    pub(super) fn send_again(&mut self, session: NodeId) {
        let now = clock::now();
        if self.log.may_write(Warning::NotSent, now) {
            warn!(%session, "no memory to send to a node: trying again");
        }
        self.send_again = Some(now.after(SEND_PAUSE));
    }

    pub(super) fn resume_sending(&mut self) {
        if self.send_again.is_none_or(|again| clock::now() < again) {
            return;
        }
        self.send_again = None;
        let all = self.connections.iter();
        let waiting = all.filter(|(_, connection)| connection.is_waiting());
        let waiting: Vec<NodeId> = waiting.map(|(&session, _)| session).collect();
        for session in waiting {
            self.make_room(session);
        }
        self.report_sockets();
    }

    /// Handles too many descriptors in flight. The kernel counts all of them for this process, whichever node
    /// does not read. Gives up the node that left the most unread, if these are many, and pauses sending to
    /// all others.
    //= SM2-TRN-009
    pub(super) fn crowded(&mut self) {
        self.send_again = Some(clock::now().after(SEND_PAUSE));
        let all = self.connections.iter_mut();
        let all = all.map(|(session, connection)| (connection.unread_fds(), session, connection));
        if let Some((unread, &session, deaf)) = all.max_by_key(|(unread, ..)| *unread)
            && unread > UNREAD
        {
            deaf.give_up();
            self.given_up.push_back(session);
        }
    }
}
