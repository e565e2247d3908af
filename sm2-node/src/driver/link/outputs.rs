//! Carries out the outputs of a link's machine: sends packets, maps descriptors, and closes the
//! link.

use std::fmt::Display;
use std::io::{self, IoSlice};
use std::mem;
use std::os::fd::AsFd;
use std::sync::Arc;

use sm2_io::memfd::{Side, blame};
use sm2_io::{InspectedFd, Interest, Ring, SendError, is_shortage};
use sm2_proto::link::{Attachment, End, Input, LaneKind, Output, RingLayout};
use sm2_proto::{Code, Farewell, Machine, ViolationKind};

use super::{LinkDriver, Unsent};
use crate::driver::datagram::Incoming;
use crate::driver::event_sets::LinkSets;
use crate::driver::outbox::{MessageKey, Outbox};
use crate::quota::{MappedSegment, QuotaExceeded};

impl LinkDriver {
    /// Carries out all outputs of the machine. Only this function matches them.
    pub(in crate::driver) fn drain(
        &mut self,
        mut came: Incoming,
        sets: &LinkSets,
        outbox: &mut Outbox,
    ) {
        while let Some(output) = self.next_output() {
            match output {
                Output::Transmit(packet) => {
                    let segment = packet.attachment.and_then(|it| outbox.segment(it));
                    self.transmit(Unsent { packet, segment }, sets, outbox);
                }
                Output::Opened => self.forget_unused_ring(),
                Output::Ring(layout) => self.map_ring(layout, came.take_file()),
                Output::Attach {
                    segment,
                    stride,
                    slots,
                } => self.attach(segment, stride * u64::from(slots), came.take_file()),
                Output::Detach { segment } => {
                    self.mapped.segments.remove(segment);
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
                Output::Ended(end) => self.hang_up(end, sets),
            }
        }
    }

    /// The next output of the machine. If an output could not be carried out, the link ends first: a
    /// packet that follows a lost one would look like a violation.
    fn next_output(&mut self) -> Option<Output> {
        if let Some(code) = self.failing.take()
            && self.end().is_none()
        {
            let _ = self
                .machine
                .handle(sm2_io::clock::now(), Input::Close(code));
        }
        self.machine.poll()
    }

    fn transmit(&mut self, unsent: Unsent, sets: &LinkSets, outbox: &Outbox) {
        match self.offer(&unsent, outbox) {
            // The other side has closed the socket. The datagrams that it sent before are read
            // first, and then the end of the stream (SM2-TRN-005).
            Ok(()) | Err(SendError::Closed) => {
                if unsent.packet.attachment == Some(Attachment::Ring) {
                    self.own_ring = None;
                }
            }
            Err(SendError::WouldBlock) => self.keep_unsent(unsent, sets),
            //= SM2-TRN-013
            Err(SendError::Io(error)) if is_shortage(&error) => {
                self.be_short_of_memory();
                self.keep_unsent(unsent, sets);
            }
            //= SM2-TRN-009
            Err(error @ (SendError::TooManyInFlight | SendError::TooLong | SendError::Io(_))) => {
                self.fail(Farewell::Resources, &error);
            }
        }
    }

    /// Keeps a packet until the socket is writable.
    fn keep_unsent(&mut self, unsent: Unsent, sets: &LinkSets) {
        let _ = self.machine.handle(sm2_io::clock::now(), Input::Blocked);
        self.unsent = Some(unsent);
        self.watch(Interest::BOTH, sets);
    }

    fn offer(&self, unsent: &Unsent, outbox: &Outbox) -> Result<(), SendError> {
        let Unsent { packet, segment } = unsent;
        let socket = self.socket.as_ref().ok_or(SendError::Closed)?;
        let parts = [IoSlice::new(&packet.head), IoSlice::new(&packet.payload)];
        let parts = &parts[..if packet.payload.is_empty() { 1 } else { 2 }];
        let fd = match packet.attachment {
            None => return socket.send(parts, &[]),
            Some(Attachment::Segment(_)) => segment.as_ref().map(AsFd::as_fd),
            Some(Attachment::Message(key)) => outbox.sealed_file(MessageKey::from_raw(key)),
            Some(Attachment::Ring) => self.own_ring.as_ref().map(AsFd::as_fd),
        };
        let fd = fd.ok_or_else(|| io::Error::from(io::ErrorKind::NotFound));
        socket.send(parts, &[fd.map_err(SendError::Io)?])
    }

    /// Sends the packet and the DOORBELL that were kept, because the socket is writable again.
    pub(super) fn flush(&mut self, sets: &LinkSets, outbox: &mut Outbox) {
        let (unsent, bell_due) = (self.unsent.take(), mem::take(&mut self.bell_due));
        if unsent.is_none() && !bell_due {
            return;
        }
        self.watch(Interest::READABLE, sets);
        if bell_due {
            self.ring_bell(sets);
        }
        if let Some(unsent) = unsent {
            let _ = self.machine.handle(sm2_io::clock::now(), Input::Writable);
            self.transmit(unsent, sets, outbox);
        }
        self.drain(Incoming::default(), sets, outbox);
    }

    pub(super) fn watch(&mut self, interest: Interest, sets: &LinkSets) {
        if let Some(socket) = &self.socket
            && let Err(error) = sets.watch_link(socket, self.origin.token, interest)
        {
            self.fail(Farewell::Resources, &error);
        }
        self.watch_in_background(sets);
    }

    /// Maps the ring that the other side created.
    fn map_ring(&mut self, layout: RingLayout, fd: Option<InspectedFd>) {
        let mapped = fd
            .ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))
            .and_then(|fd| fd.into_ring().map_err(io::Error::other))
            .and_then(|file| Ring::map(&file, layout));
        match mapped {
            Ok(ring) => self.mapped.outgoing = Some(ring),
            Err(error) => self.refuse_file(&error),
        }
    }

    /// Maps a segment of the other side once, for all messages in it.
    //= SM2-PAY-007, SM2-SEG-006
    fn attach(&mut self, segment: u32, len: u64, fd: Option<InspectedFd>) {
        let mapped = fd
            .ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))
            .and_then(|fd| fd.into_pooled().map_err(io::Error::other))
            .and_then(|file| MappedSegment::new(&file, len, &self.quota));
        match mapped {
            Ok(mapping) => {
                self.mapped.segments.insert(segment, Arc::new(mapping));
            }
            Err(error) => self.refuse_file(&error),
        }
    }

    /// Keeps the file of a sealed message until the application takes the message.
    fn keep(&mut self, sequence: u64, fd: InspectedFd) {
        match fd.into_sealed() {
            Ok(file) => {
                self.kept.insert(sequence, file);
            }
            // The machine has already checked the same facts.
            Err(error) => self.fail(Farewell::Resources, &error),
        }
    }

    /// Requests the end of the link, because a file of the other side cannot be used.
    //= SM2-SEG-001, SM2-SEG-006
    pub(in crate::driver) fn refuse_file(&mut self, error: &io::Error) {
        let is_too_long = error.get_ref().is_some_and(|it| it.is::<QuotaExceeded>());
        match blame(error) {
            Side::Sender if !is_too_long => self.fail(ViolationKind::NotAMemfd, error),
            Side::Sender | Side::Receiver => self.fail(Farewell::Resources, error),
        }
    }

    /// Requests the end of the link before its next output.
    pub(in crate::driver) fn fail(&mut self, code: impl Into<Code> + Display, error: &dyn Display) {
        tracing::warn!(link = %self.id, peer = %self.origin.peer.name, %error, "link given up: {code}");
        self.failing = Some(code.into());
    }

    /// Unmaps the ring of this side if the other side does not offer the ring lane.
    fn forget_unused_ring(&mut self) {
        if self.machine.lane() == LaneKind::Socket {
            self.mapped.incoming = None;
        }
    }

    //= SM2-OPN-008, SM2-OPN-009
    fn hang_up(&mut self, end: End, sets: &LinkSets) {
        self.unsent = None;
        self.bell_due = false;
        self.short_of_memory = false;
        self.write_shortage();
        self.failing = None;
        self.mapped.outgoing = None;
        self.own_ring = None;
        self.room = None;
        if let Some(socket) = self.socket.take() {
            sets.remove_link(&socket);
            // A child process may have inherited the socket, so closing it might not tell the other
            // side.
            let _ = socket.shutdown();
        }
        self.forget_unused();
        self.log_end(end);
    }

    /// Logs the end of the link, as the last step: if the program's logger panics, the rest is done.
    fn log_end(&self, end: End) {
        let (link, peer) = (self.id, &self.origin.peer.name);
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
    }

    /// Drops the mappings and files, unless a message that can still be taken needs them.
    pub(super) fn forget_unused(&mut self) {
        // The calls of a link that is over still get the replies that are left in their ring, or
        // fail.
        if !self.may_take() && self.calls() == 0 {
            self.mapped.segments.clear();
            self.kept.clear();
            self.mapped.incoming = None;
        }
    }
}
