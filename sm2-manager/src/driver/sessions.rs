//! A session in the driver, from its connection to its end.

use std::{
    io,
    os::fd::{AsFd, OwnedFd},
    sync::Arc,
};

use sm2_io::{
    Event, InspectedFd, Interest, PeerProcess, ProcessFd, RecvError, SeqPacket, clock, is_shortage,
};
use sm2_proto::{
    Code, Datagram, Farewell, Instant, NodeId,
    manager::{Cause, Credentials, Input},
};
use tracing::{debug, warn};

use super::{Manager, PROCESS, TURN, door::LISTENER, log_limit::Warning};
use crate::connection::{Connection, Lost, Sent};

/// A connection that was accepted.
pub(super) struct Arrival {
    socket: SeqPacket,
    /// A descriptor that is reserved for its counters file.
    place: OwnedFd,
}

impl Manager {
    /// Accepts the next connection and reserves a descriptor for its counters file. Without the descriptors that a
    /// connection needs, it stays in the queue.
    pub(super) fn let_in(&self) -> io::Result<Option<Arrival>> {
        let (place, process) = (self.place()?, self.place()?);
        let Some(socket) = self.door.accept()? else {
            return Ok(None);
        };
        // Makes room for the descriptor of the process.
        drop(process);
        Ok(Some(Arrival { socket, place }))
    }

    //= SM2-TRN-006
    pub(super) fn connect(&mut self, Arrival { socket, place }: Arrival) {
        self.last_session += 1;
        let session = NodeId(self.last_session);
        let watched = self.epoll.add(&socket, session.0, Interest::READABLE);
        let peer = watched.and_then(|()| {
            let process = self.watch_process(session, &socket)?;
            // Also without a policy: the domain may get one.
            Ok((socket.peer_credentials()?, socket.peer_groups()?, process))
        });
        let (peer, groups, process) = match peer {
            Ok(peer) => peer,
            Err(error) => {
                if self.log.may_write(Warning::NotServed, clock::now()) {
                    warn!(%error, "cannot serve a connection");
                }
                return;
            }
        };
        debug!(%session, uid = peer.uid, pid = peer.pid, "connected");
        self.connections
            .insert(session, Connection::new(socket, place, process));
        let credentials = Credentials {
            uid: peer.uid,
            gid: peer.gid,
            pid: peer.pid,
        };
        self.feed(Input::Connected {
            session,
            credentials,
        });
        let gids = &groups;
        self.feed(Input::Groups { session, gids });
    }

    /// Watches the process that has connected. If it has ended, its connection ends at once.
    //= SM2-SES-011
    fn watch_process(&self, session: NodeId, socket: &SeqPacket) -> io::Result<Option<ProcessFd>> {
        match PeerProcess::of(socket)? {
            PeerProcess::Running(process) => {
                let token = session.0 | PROCESS;
                self.epoll.add(&process, token, Interest::READABLE)?;
                Ok(Some(process))
            }
            PeerProcess::Ended => socket.shutdown().map(|()| None),
            PeerProcess::Unknown => Ok(None),
        }
    }

    /// Ends the connections of processes that have ended: other processes may have their descriptors. Replaces the
    /// events of such processes by the ends of their sockets. The datagrams that these hold are still read.
    //= SM2-SES-011
    pub(super) fn end_processes(&mut self, ready: &mut Vec<Event>) {
        let is_process = |it: &Event| it.token != LISTENER && it.token & PROCESS != 0;
        if !ready.iter().any(is_process) {
            return;
        }
        for event in ready.iter_mut().filter(|it| is_process(it)) {
            event.token &= !PROCESS;
            event.hangup = true;
            if let Some(connection) = self.connections.get_mut(&NodeId(event.token)) {
                connection.forget_process(&self.epoll);
                // An error means that the other end is closed.
                let _ = connection.socket.shutdown();
            }
        }
        // The socket of such a session may have an event, too.
        ready.sort_by_key(|it| (it.token, !it.hangup));
        ready.dedup_by_key(|it| it.token);
    }

    /// Serves a session until the round is over. The frames of a busy session stay in its socket.
    //= SM2-SES-009
    pub(super) fn serve(&mut self, session: NodeId, event: Event, until: Instant) {
        if event.writable {
            self.make_room(session);
            self.report_sockets();
        }
        // A closed connection is read to its end. The kernel's buffer bounds how much that is.
        let turns = if event.hangup { usize::MAX } else { TURN };
        for _ in 0..turns {
            if !event.readable || self.machine.is_busy(session) || !self.receive(session) {
                return;
            }
            if clock::now() >= until {
                return;
            }
        }
    }

    /// Reads one datagram. Returns whether there may be another one.
    fn receive(&mut self, session: NodeId) -> bool {
        let Some(connection) = self.connections.get_mut(&session) else {
            return false;
        };
        // Frees the reserved descriptor, so that the datagram's descriptor can be received.
        connection.place = None;
        let mut buffer = std::mem::take(&mut self.buffer);
        let received = connection.socket.recv(&mut buffer);
        let used = received.as_ref().is_ok_and(|it| !it.fds.is_empty());
        if !used {
            self.keep_place(session);
        }
        let go_on = match received {
            Ok(received) => {
                // The machine needs the facts for its decision. For a descriptor that is not a memory file the
                // kernel gives none, and the machine refuses it. A descriptor whose facts find no memory
                // is lost, like one that finds no room.
                let fds = received.fds.into_iter().map(InspectedFd::new);
                let fds: io::Result<Vec<_>> = fds.collect();
                let is_lost = received.control_truncated || fds.is_err();
                let fds = fds.unwrap_or_default();
                //= SM2-TRN-011
                if is_lost && self.log.may_write(Warning::NotReceived, clock::now()) {
                    warn!(
                        %session,
                        "no free descriptor or no memory for a node's file: raise the limit of open files (ulimit -n)"
                    );
                }
                let facts: Vec<_> = fds.iter().map(InspectedFd::facts).collect();
                let datagram = Datagram {
                    bytes: &buffer[..received.len],
                    fds: &facts,
                    data_truncated: received.data_truncated,
                    control_truncated: is_lost,
                };
                self.feed_with(Input::Datagram { session, datagram }, fds);
                true
            }
            Err(RecvError::WouldBlock) => false,
            Err(RecvError::Closed) => {
                self.feed(Input::Closed { session });
                false
            }
            Err(RecvError::Io(error)) => {
                if self.log.may_write(Warning::NotRead, clock::now()) {
                    warn!(%session, %error, "cannot read from a node");
                }
                //= SM2-TRN-012
                match is_shortage(&error) {
                    true => self.is_short_of_memory = true,
                    false => self.feed(Input::Closed { session }),
                }
                false
            }
        };
        self.buffer = buffer;
        if used {
            self.keep_place(session);
        }
        go_on
    }

    /// Reserves a descriptor while the node may still hand over its counters file.
    fn keep_place(&mut self, session: NodeId) {
        let owes = |it: &Connection| it.counters.is_none();
        if self.connections.get(&session).is_some_and(owes) {
            let place = self.place().ok();
            if let Some(connection) = self.connections.get_mut(&session) {
                connection.place = place;
            }
        }
    }

    fn place(&self) -> io::Result<OwnedFd> {
        sm2_io::duplicate(&*self.handles.stop)
    }

    pub(super) fn make_room(&mut self, session: NodeId) {
        let Some(connection) = self.connections.get_mut(&session) else {
            return;
        };
        let flushed = connection.flush();
        self.sent(session, flushed);
    }

    /// Watches the socket for room exactly as long as frames are queued.
    fn sent(&mut self, session: NodeId, sent: Result<Sent, Lost>) {
        let interest = match sent {
            Ok(Sent::Taken) => {
                if self.machine.awaits_room(session) {
                    self.drained.insert(session);
                }
                Interest::READABLE
            }
            Ok(Sent::Full) => Interest::BOTH,
            Ok(Sent::Crowded) => {
                self.crowded();
                Interest::READABLE
            }
            Ok(Sent::Short) => {
                self.send_again(session);
                Interest::READABLE
            }
            // A closed socket is readable, and reading reports the reason.
            Err(Lost::Closed) => return,
            Err(Lost::Stalled) => return self.given_up.push_back(session),
        };
        if let Some(connection) = self.connections.get_mut(&session)
            && connection.interest != interest
        {
            match self.epoll.modify(&connection.socket, session.0, interest) {
                Ok(()) => connection.interest = interest,
                // Sending again changes the interest again.
                //= SM2-TRN-012
                Err(_) => self.send_again(session),
            }
        }
    }

    //= SM2-LNK-001
    pub(super) fn send(&mut self, session: NodeId, frame: Vec<u8>, fd: Option<Arc<OwnedFd>>) {
        let Some(connection) = self.connections.get_mut(&session) else {
            return;
        };
        let sent = connection.send(frame, fd, self.queue_bytes);
        self.sent(session, sent);
    }

    /// Whether the log has room for the end of another session with this code.
    fn may_warn(&mut self, code: Code) -> bool {
        let now = clock::now();
        self.log.may_write(Warning::HungUp(code), now)
    }

    /// Ends a session. Every session ends here.
    pub(super) fn hang_up(&mut self, session: NodeId, goodbye: Option<Vec<u8>>, cause: Cause) {
        match cause {
            Cause::Violation(violation) if self.may_warn(violation.code()) => {
                let (violation, clause) = (violation.kind(), violation.clause());
                warn!(%session, %violation, %clause, "hung up: the node broke the protocol");
            }
            Cause::Farewell(Farewell::ShuttingDown) => debug!(%session, "said goodbye"),
            Cause::Farewell(why) if self.may_warn(why.code()) => {
                warn!(%session, %why, clause = %why.clause(), "hung up");
            }
            Cause::Violation(_) | Cause::Farewell(_) => {}
            Cause::Goodbye(code) => debug!(%session, %code, "the node said goodbye"),
            Cause::Gone => debug!(%session, "the node is gone"),
        }
        let Some(mut connection) = self.connections.remove(&session) else {
            return;
        };
        // Closing would remove the socket from the set only after every duplicate is closed.
        let _ = self.epoll.remove(connection.socket.as_fd());
        connection.forget_process(&self.epoll);
        connection.say_goodbye(goodbye);
    }
}
