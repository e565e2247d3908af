//! What a link's machine says is done: packets go out, what came with them is mapped, and the end.

use std::fmt::Display;
use std::io::{self, IoSlice};
use std::os::fd::AsFd;
use std::sync::Arc;

use sm2_io::{Epoll, InspectedFd, Interest, PooledMapping, SendError};
use sm2_proto::Farewell;
use sm2_proto::link::{self, End, Input, Output, Packet};

use super::LinkDriver;
use crate::driver::datagram::Incoming;
use crate::driver::message_key::MessageKey;
use crate::driver::outbox::Outbox;

impl LinkDriver {
    /// Does all that the machine says: the one place where its outputs are matched.
    pub(super) fn drain(&mut self, mut came: Incoming, epoll: &Epoll, outbox: &mut Outbox) {
        loop {
            while let Some(output) = self.machine.poll() {
                match output {
                    Output::Transmit(packet) => self.transmit(packet, epoll, outbox),
                    // A ring that was prepared and not asked for is not needed.
                    Output::Opened => self.prepared = None,
                    Output::MakeRing(_) => self.use_prepared_ring(),
                    Output::Ring(layout) => self.map_ring(layout, came.take_file()),
                    Output::Attach {
                        segment,
                        stride,
                        slots,
                    } => self.attach(segment, stride * u64::from(slots), came.take_file()),
                    Output::Detach { segment } => {
                        self.mapped.segments.remove(&segment);
                    }
                    Output::Keep { sequence } => {
                        if let Some(fd) = came.take_file() {
                            self.keep(sequence, fd);
                        }
                    }
                    Output::Discard { sequence } => {
                        self.kept.remove(&sequence);
                    }
                    Output::Settled { key, fate } => outbox.settle(MessageKey::from_raw(key), fate),
                    Output::Cancelled { call } => {
                        self.cancelled.insert(call);
                    }
                    Output::CallFailed { call } => self.failed.push(call),
                    Output::Ended(end) => self.hang_up(end, epoll),
                }
            }
            match self.failing.take() {
                Some(code) if self.end().is_none() => {
                    let _ = self
                        .machine
                        .handle(sm2_io::clock::now(), Input::Close(code));
                }
                _ => return,
            }
        }
    }

    fn transmit(&mut self, packet: Packet, epoll: &Epoll, outbox: &Outbox) {
        match self.offer(&packet, outbox) {
            // Whoever closed has sent all it will: that is read first, and then the end of
            // the stream (SM2-TRN-006).
            Ok(()) | Err(SendError::Closed) => {
                if packet.attachment == Some(link::Attachment::Ring) {
                    self.ring_file = None;
                }
            }
            Err(SendError::WouldBlock) => {
                let _ = self.machine.handle(sm2_io::clock::now(), Input::Blocked);
                self.unsent = Some(packet);
                self.watch(Interest::BOTH, epoll);
            }
            //= SM2-TRN-010
            Err(SendError::TooManyInFlight) => {
                self.fail(Farewell::Stalled, &SendError::TooManyInFlight)
            }
            Err(error @ (SendError::TooLong | SendError::Io(_))) => {
                self.fail(Farewell::Resources, &error);
            }
        }
    }

    fn offer(&self, packet: &Packet, outbox: &Outbox) -> Result<(), SendError> {
        let socket = self.socket.as_ref().ok_or(SendError::Closed)?;
        let parts = [IoSlice::new(&packet.head), IoSlice::new(&packet.payload)];
        let parts = &parts[..if packet.payload.is_empty() { 1 } else { 2 }];
        let Some(attachment) = packet.attachment else {
            return socket.send(parts, &[]);
        };
        let ring = self.ring_file.as_ref().map(AsFd::as_fd);
        let Some(fd) = outbox.descriptor(attachment).or(ring) else {
            return Err(SendError::Io(io::ErrorKind::NotFound.into()));
        };
        socket.send(parts, &[fd])
    }

    /// The socket takes packets again.
    pub(super) fn flush(&mut self, epoll: &Epoll, outbox: &mut Outbox) {
        let Some(packet) = self.unsent.take() else {
            return;
        };
        let _ = self.machine.handle(sm2_io::clock::now(), Input::Writable);
        self.watch(Interest::READABLE, epoll);
        self.transmit(packet, epoll, outbox);
        self.drain(Incoming::default(), epoll, outbox);
    }

    fn watch(&mut self, interest: Interest, epoll: &Epoll) {
        if let Some(socket) = &self.socket
            && let Err(error) = epoll.modify(socket, self.token.0, interest)
        {
            self.fail(Farewell::Resources, &error);
        }
    }

    /// Maps a segment of the other side, once and for all of its messages.
    //= SM2-PAY-007
    fn attach(&mut self, segment: u32, len: u64, fd: Option<InspectedFd>) {
        let mapped = fd
            .ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))
            .and_then(|fd| fd.into_pooled().map_err(io::Error::other))
            .and_then(|file| PooledMapping::new(&file, len, false));
        match mapped {
            Ok(mapping) => {
                self.mapped.segments.insert(segment, Arc::new(mapping));
            }
            Err(error) => self.fail(Farewell::Resources, &error),
        }
    }

    /// Keeps the file of a sealed message until the application takes the message.
    fn keep(&mut self, sequence: u64, fd: InspectedFd) {
        match fd.into_sealed() {
            Ok(file) => {
                self.kept.insert(sequence, file);
            }
            // The machine has judged the same facts.
            Err(error) => self.fail(Farewell::Resources, &error),
        }
    }

    /// The link has to be ended, as soon as the machine's outputs are done.
    pub(in crate::driver) fn fail(&mut self, code: Farewell, error: &dyn Display) {
        tracing::warn!(link = %self.id, peer = %self.peer.name, %error, "link given up: {code}");
        self.failing = Some(code.code());
    }

    /// The ring that was prepared before OPEN is the one that the machine asks for.
    fn use_prepared_ring(&mut self) {
        debug_assert!(self.prepared.is_some());
        if let Some((ring, file)) = self.prepared.take() {
            self.mapped.incoming = Some(ring);
            self.ring_file = Some(file);
        }
    }

    //= SM2-OPN-006, SM2-OPN-007
    fn hang_up(&mut self, end: End, epoll: &Epoll) {
        let (link, peer) = (self.id, &self.peer.name);
        match end {
            End::Violation(violation) => tracing::warn!(
                %link, %peer,
                violation = %violation.kind(),
                clause = %violation.clause(),
                "the other side broke the protocol; the link is over"
            ),
            End::Peer(code) if code != Farewell::Done.code() => {
                tracing::warn!(%link, %peer, %code, "the other side ended the link");
            }
            End::Peer(_) | End::Eof | End::Local(_) => tracing::debug!(%link, %peer, %end),
        }
        self.unsent = None;
        self.failing = None;
        self.prepared = None;
        self.mapped.outgoing = None;
        if let Some(socket) = self.socket.take() {
            let _ = epoll.remove(&socket);
            // A child process may have inherited it: the other side must learn of the end.
            let _ = socket.shutdown();
        }
        self.forget_unused();
    }

    /// What messages that are still to be taken do not need goes now.
    pub(super) fn forget_unused(&mut self) {
        // The calls of a link that is over get what is left in their ring, or fail.
        if !self.is_ready() && self.calls() == 0 {
            self.mapped.segments.clear();
            self.kept.clear();
            self.mapped.incoming = None;
            self.ring_file = None;
        }
    }
}
