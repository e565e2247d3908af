//! Reading the socket of a link, and feeding its machine.

use sm2_io::{Event, RecvError, is_shortage};
use sm2_proto::link::{self, Input};
use sm2_proto::{Code, Datagram, Farewell, Machine};

use super::LinkDriver;
use crate::driver::context::Context;
use crate::driver::datagram::{Incoming, receive, with_buffer};
use crate::driver::event_sets::LinkSets;
use crate::driver::limits::{BURST, LAST_WORDS};
use crate::driver::outbox::Outbox;

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
        self.short_of_memory = false;
        if event.writable {
            self.flush(context.sets, outbox);
        }
        if event.readable {
            self.receive(BURST, context, outbox);
        }
        self.write_shortage();
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
            let Some(socket) = &self.socket else { return };
            match receive(socket, buffer) {
                Ok(incoming) => {
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

    /// Drains the machine if it may have outputs. Returns whether it may have had some.
    #[inline]
    pub(in crate::driver) fn drain_if_due(&mut self, sets: &LinkSets, outbox: &mut Outbox) -> bool {
        let is_due = self.machine.has_output();
        if is_due {
            self.drain_idle(sets, outbox);
        }
        is_due
    }
}
