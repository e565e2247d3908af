//! When descriptors are short: those of this process, or those in flight.

use std::{io, time::Duration};

use nix::libc;
use sm2_io::{SeqPacket, clock};
use sm2_proto::{NodeId, manager::Input};

use super::Manager;

/// How many descriptors may wait for one node while descriptors are short: what a node
/// that is busy for a moment needs.
const HOARD: usize = 64;
/// How many descriptors a node may have left unread while too many are in flight: what one
/// that is busy for a moment has.
const UNREAD: usize = 32;
/// After how long sending is tried again when too many descriptors are in flight.
const CROWDED_PAUSE: Duration = Duration::from_millis(10);

impl Manager {
    /// The two ends of a link.
    pub(super) fn pair(&mut self) -> io::Result<(SeqPacket, SeqPacket)> {
        loop {
            match SeqPacket::pair() {
                Err(error) if self.make_descriptors(&error) => {}
                result => return result,
            }
        }
    }

    /// Where descriptors ran out, gives up the node that makes us keep the most of them:
    /// one that does not read shall not keep others from being served. Whether there
    /// are more now.
    //= SM2-TRN-009
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
        self.feed(Input::Tick);
    }

    /// Descriptors in flight are counted for us, whoever does not take them. So whoever
    /// left most unread is given up, if it is much, and all others wait a moment.
    //= SM2-TRN-010
    pub(super) fn crowded(&mut self) {
        self.send_again = Some(clock::now().after(CROWDED_PAUSE));
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
