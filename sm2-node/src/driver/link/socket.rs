//! Reading the socket of a link, feeding its machine, and carrying out the outputs of the machine: it sends packets,
//! maps descriptors, and closes the link.

use std::fmt::Display;
use std::io;
use std::sync::Arc;

use sm2_io::memfd::{Side, blame};
use sm2_io::{Event, InspectedFd, Interest, RecvError, Ring, SendError, is_shortage};
use sm2_proto::link::{self, Attachment, End, Input, LaneKind, Output, RingLayout, Wake};
use sm2_proto::{Code, Datagram, Farewell, Machine, ViolationKind};

use super::LinkDriver;
use super::wire::{Unsent, Wire};
use crate::driver::context::Context;
use crate::driver::datagram::{Incoming, receive, with_buffer};
use crate::driver::event_sets::LinkSets;
use crate::driver::limits::{BURST, LAST_WORDS};
use crate::driver::origin::LinkSegment;
use crate::driver::outbox::{MessageKey, Outbox};
use crate::quota::{MappedSegment, QuotaExceeded};

impl LinkDriver {
    /// Sends the first packet.
    pub(in crate::driver) fn start(&mut self, sets: &LinkSets, outbox: &mut Outbox) {
        self.drain(Incoming::default(), sets, outbox);
    }

    /// Handles an event of the socket, which is readable, writable, or both.
    pub(in crate::driver) fn on_event(
        &mut self,
        event: Event,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        self.set_short_of_memory(false);
        if event.writable {
            self.flush(context.sets, outbox);
        }
        if event.readable {
            self.receive(BURST, context, outbox);
        }
        self.counting.write_shortage(self.is_short_of_memory());
    }

    /// Reads all datagrams that the socket has, up to the number that a peer that obeys SPEC can
    /// have sent.
    pub(in crate::driver) fn receive_all(
        &mut self,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        self.receive(LAST_WORDS, context, outbox);
    }

    /// Reads at most `most` datagrams.
    //= SM2-TRN-013
    fn receive(&mut self, most: usize, context: &mut Context<'_>, outbox: &mut Outbox) {
        if with_buffer(|buffer| self.receive_into(buffer, most, context, outbox)).is_err() {
            self.be_short_of_memory();
        }
    }

    fn receive_into(
        &mut self,
        buffer: &mut [u8],
        most: usize,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        for _ in 0..most {
            let Some(wire) = &self.wire else { return };
            match receive(&wire.socket, buffer) {
                Ok(incoming) => {
                    // A thread that sleeps until this datagram comes does not see it in the socket any more.
                    context.socket_read = true;
                    self.settle_returned(context, outbox);
                    let bytes = &buffer[..incoming.len];
                    self.datagram(bytes, incoming, context.sets, outbox);
                }
                Err(RecvError::WouldBlock) => return,
                //= SM2-TRN-005
                // `Closed` comes after all queued datagrams.
                Err(RecvError::Closed) => {
                    self.settle_returned(context, outbox);
                    return self.feed(Input::Eof, context.sets, outbox);
                }
                //= SM2-TRN-013
                // The socket stays readable.
                Err(RecvError::Io(error)) if is_shortage(&error) => {
                    self.be_short_of_memory();
                    return;
                }
                Err(RecvError::Io(error)) => {
                    tracing::warn!(link = %self.id, peer = %self.origin.peer.name, %error, "link failed");
                    self.settle_returned(context, outbox);
                    return self.feed(Input::Eof, context.sets, outbox);
                }
            }
        }
    }

    fn datagram(&mut self, bytes: &[u8], came: Incoming, sets: &LinkSets, outbox: &mut Outbox) {
        let datagram = Datagram {
            bytes,
            fds: &came.facts,
            data_truncated: came.data_truncated,
            control_truncated: came.control_truncated,
        };
        //= SM2-TRN-011
        if came.control_truncated {
            let (link, peer) = (self.id, &self.origin.peer.name);
            tracing::warn!(%link, %peer, "no free descriptor for a frame: raise the limit of open files (ulimit -n)");
        }
        // If the datagram is a violation, the outputs report it.
        let _ = self
            .machine
            .handle(sm2_io::clock::now(), Input::Datagram(datagram));
        self.drain(came, sets, outbox);
    }

    /// Feeds an input to the machine and carries out the outputs.
    pub(in crate::driver) fn feed(
        &mut self,
        input: Input<'_>,
        sets: &LinkSets,
        outbox: &mut Outbox,
    ) {
        let result = self.machine.handle(sm2_io::clock::now(), input);
        debug_assert!(
            !matches!(result, Err(link::Error::Misuse(_))),
            "{result:?} on {}",
            self.id
        );
        self.drain(Incoming::default(), sets, outbox);
    }

    /// Handles UNLINK: the Manager says that the other side is gone. Messages that the other side
    /// sent before still count. If the access policy denies the link, they count as lost.
    //= SM2-TRN-005, SM2-LNK-005, SM2-ACC-014
    pub(in crate::driver) fn unlink(
        &mut self,
        code: Code,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        if code == Farewell::Denied.code() {
            self.deny();
        }
        self.receive_all(context, outbox);
        if self.end().is_none() {
            self.settle_returned(context, outbox);
            self.feed(Input::Close(code), context.sets, outbox);
        }
    }

    /// Carries out the outputs of the machine when no datagram was fed.
    pub(in crate::driver) fn drain_idle(&mut self, sets: &LinkSets, outbox: &mut Outbox) {
        self.drain(Incoming::default(), sets, outbox);
    }

    /// Drains the machine if it may have outputs.
    #[inline]
    pub(in crate::driver) fn drain_if_due(&mut self, sets: &LinkSets, outbox: &mut Outbox) {
        if self.machine.has_output() {
            self.drain_idle(sets, outbox);
        }
    }

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
                    self.received.discarded += 1;
                    self.kept.remove(&sequence);
                }
                Output::Settled { key, fate } => outbox.settle(MessageKey::from_raw(key), fate),
                Output::Cancelled { call } => {
                    self.calls.cancelled.insert(call);
                }
                Output::CallFailed { call } => self.calls.failed.push(call),
                Output::Ended(end) => self.hang_up(end, sets),
            }
        }
    }

    /// The next output of the machine. If an output could not be carried out, the link ends first: a
    /// packet that follows a lost one would look like a violation.
    fn next_output(&mut self) -> Option<Output> {
        if let Some(code) = self.wire.as_mut().and_then(|it| it.failing.take())
            && self.end().is_none()
        {
            let _ = self
                .machine
                .handle(sm2_io::clock::now(), Input::Close(code));
        }
        self.machine.poll()
    }

    fn transmit(&mut self, unsent: Unsent, sets: &LinkSets, outbox: &Outbox) {
        let Some(wire) = &mut self.wire else {
            return;
        };
        match wire.offer(&unsent, outbox) {
            // The other side has closed the socket. The datagrams that it sent before are read
            // first, and then the end of the stream (SM2-TRN-005).
            Ok(()) | Err(SendError::Closed) => {
                if unsent.packet.attachment == Some(Attachment::Ring) {
                    wire.own_ring = None;
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
        if let Some(wire) = &mut self.wire {
            wire.unsent = Some(unsent);
        }
        self.watch(Interest::BOTH, sets);
    }

    /// Sends the packet and the DOORBELL that were kept, because the socket is writable again.
    pub(super) fn flush(&mut self, sets: &LinkSets, outbox: &mut Outbox) {
        let waiting = self.wire.as_mut().and_then(Wire::take_waiting);
        let Some((unsent, is_bell_due)) = waiting else {
            return;
        };
        self.watch(Interest::READABLE, sets);
        if is_bell_due {
            self.ring_bell(sets);
        }
        if let Some(unsent) = unsent {
            let _ = self.machine.handle(sm2_io::clock::now(), Input::Writable);
            self.transmit(unsent, sets, outbox);
        }
        self.drain_idle(sets, outbox);
    }

    /// Changes the events that wake calls.
    pub(super) fn watch(&mut self, interest: Interest, sets: &LinkSets) {
        if let Some(wire) = &self.wire
            && let Err(error) = wire.watch(interest, sets)
        {
            self.fail(Farewell::Resources, &error);
        }
        self.watch_in_background(sets);
    }

    /// Wakes the other side if that is needed.
    //= SM2-RNG-012
    #[inline]
    pub(in crate::driver) fn wake(&mut self, wake: Wake, sets: &LinkSets) {
        if wake.is_needed() {
            self.ring_bell(sets);
        }
    }

    fn ring_bell(&mut self, sets: &LinkSets) {
        if self.wire.as_mut().is_some_and(Wire::ring_bell) {
            self.be_short_of_memory();
            self.watch(Interest::BOTH, sets);
        }
    }

    /// Memory is short, on this end of the link.
    //= SM2-TRN-013
    #[cold]
    pub(super) fn be_short_of_memory(&mut self) {
        self.set_short_of_memory(true);
        self.counting.write_shortage(true);
    }

    pub(super) const fn set_short_of_memory(&mut self, is_short: bool) {
        if let Some(wire) = &mut self.wire {
            wire.is_short_of_memory = is_short;
        }
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
                let origin = Arc::clone(&self.origin);
                let mapped = Arc::new(LinkSegment { origin, mapping });
                self.mapped.segments.insert(segment, mapped);
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
        if let Some(wire) = &mut self.wire {
            wire.failing = Some(code.into());
        }
    }

    /// Unmaps the ring of this side if the other side does not offer the ring lane.
    fn forget_unused_ring(&mut self) {
        if self.machine.lane() == LaneKind::Socket {
            self.mapped.incoming = None;
        }
    }

    //= SM2-OPN-008, SM2-OPN-009
    fn hang_up(&mut self, end: End, sets: &LinkSets) {
        self.mapped.outgoing = None;
        if let Some(wire) = self.wire.take() {
            wire.close(sets);
        }
        self.counting.write_shortage(false);
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
