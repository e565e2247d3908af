//! One end of one link: its socket, its machine, and the memory that was mapped for it.
//!
//! No function in this module waits. If the socket is full, the driver keeps one packet and stops
//! the machine from transmitting. A failure ends only the link in which it occurs.

mod outputs;

use std::collections::{BTreeSet, HashMap, VecDeque};
use std::os::fd::OwnedFd;
use std::sync::Arc;

use sm2_io::memfd::SealedFile;
use sm2_io::{CounterEntry, Epoll, Event, RecvError, Ring, SegmentFd, SeqPacket};
use sm2_proto::control::LinkPeer;
use sm2_proto::link::{self, Counters, Delivery, End, Input, Link, Packet, Role, TooManyBorrowed};
use sm2_proto::{Code, Datagram, Farewell, Instant, LinkId, Machine};

use super::BURST;
use super::counters::Counting;
use super::datagram::{Incoming, receive};
use super::lane::{Mapped, prepare_ring};
use super::message_key::MessageKey;
use super::outbox::{Needs, Outbox};
use super::status::Received;
use super::token::LinkToken;
use crate::payload::Source;

/// How many datagrams are read at most from a link whose other side is gone. This exceeds the
/// number of messages in a full window, each with the ATTACH of its segment.
const LAST_WORDS: usize = 8_192;

#[derive(Debug)]
pub(crate) struct LinkDriver {
    pub(crate) id: LinkId,
    pub(crate) peer: Arc<LinkPeer>,
    token: LinkToken,
    pub(super) socket: Option<SeqPacket>,
    pub(super) machine: Link,
    /// The rings and segments that both sides map.
    pub(super) mapped: Mapped,
    /// The ring for messages to this side and its file, until both ends have agreed on a lane.
    pub(super) prepared: Option<(Ring, OwnedFd)>,
    /// The file of the incoming ring, until RING was sent to the other side.
    pub(super) ring_file: Option<OwnedFd>,
    /// The packet that the socket did not accept.
    unsent: Option<Unsent>,
    /// The files of sealed messages that were not taken yet, by sequence number.
    kept: HashMap<u64, SealedFile>,
    /// Messages of the latched store that have not been sent on this link yet.
    pub(super) backlog: VecDeque<MessageKey>,
    /// Whether the interface knows that the link is open.
    pub(super) greeted: bool,
    /// Whether the interface knows that the link is over.
    pub(super) buried: bool,
    /// How many messages the application holds.
    held: usize,
    pub(super) received: Received,
    /// The entry of its counters, until the link is buried.
    pub(super) entry: Option<CounterEntry>,
    /// The values in the entry.
    pub(super) noted: Counters,
    /// Caller: the number of the last call.
    pub(super) last_call: u64,
    /// Caller: calls that failed with the link and were not reported yet.
    pub(super) failed: Vec<u64>,
    /// Server: calls that their client no longer wants.
    pub(super) cancelled: BTreeSet<u64>,
    /// The code with which this side has to end the link.
    failing: Option<Code>,
}

/// A packet that the socket did not accept.
#[derive(Debug)]
struct Unsent {
    packet: Packet,
    /// The descriptor of an ATTACH. The outbox may close the segment before the socket accepts the
    /// packet.
    segment: Option<SegmentFd>,
}

/// The parts of the node that the methods of a link use.
pub(crate) struct Tools<'a> {
    pub(crate) epoll: &'a Epoll,
    pub(crate) buffer: &'a mut [u8],
    pub(crate) counting: &'a mut Counting,
    /// The time at which the call began, for calls that wait, take or publish. Stale in
    /// all other calls.
    pub(crate) now: Instant,
    /// Whether a socket of the interface was read during this call, so that sleepers have to be
    /// woken.
    pub(crate) stirred: bool,
}

impl LinkDriver {
    pub(super) fn new(
        token: LinkToken,
        peer: Arc<LinkPeer>,
        socket: SeqPacket,
        mut config: link::Config,
        entry: Option<CounterEntry>,
    ) -> Self {
        let prepared = prepare_ring(&mut config);
        Self {
            id: config.id,
            peer,
            token,
            socket: Some(socket),
            machine: Link::new(config),
            mapped: Mapped::default(),
            prepared,
            ring_file: None,
            unsent: None,
            kept: HashMap::new(),
            backlog: VecDeque::new(),
            greeted: false,
            buried: false,
            held: 0,
            received: Received::default(),
            entry,
            noted: Counters::default(),
            last_call: 0,
            failed: Vec::new(),
            cancelled: BTreeSet::new(),
            failing: None,
        }
    }

    pub(crate) const fn token(&self) -> LinkToken {
        self.token
    }

    pub(crate) fn is_open(&self) -> bool {
        self.machine.is_open()
    }

    pub(crate) fn end(&self) -> Option<End> {
        self.machine.end()
    }

    pub(crate) fn counters(&self) -> Counters {
        self.machine.counters()
    }

    pub(crate) fn is_reliable(&self) -> bool {
        self.machine.config().reliable
    }

    pub(crate) fn is_sealed(&self) -> bool {
        self.machine.config().sealed
    }

    pub(crate) fn is_stalled(&self) -> bool {
        self.machine.is_stalled()
    }

    pub(super) fn role(&self) -> Role {
        self.machine.config().role
    }

    /// The forms in which this link accepts messages.
    pub(crate) fn needs(&self) -> Needs {
        self.machine.placement().into()
    }

    /// Whether one more message would be sent or queued without loss.
    pub(crate) fn has_room(&self) -> bool {
        self.backlog.is_empty() && self.has_room_for_backlog()
    }

    /// The same as [`has_room`](Self::has_room), for messages of the backlog, which are sent first.
    pub(super) fn has_room_for_backlog(&self) -> bool {
        self.machine.has_room(&self.mapped)
    }

    /// The number of calls without a reply.
    pub(crate) fn calls(&self) -> usize {
        self.machine.calls()
    }

    pub(crate) const fn held(&self) -> usize {
        self.held
    }

    pub(crate) fn max_borrowed(&self) -> usize {
        usize::from(self.machine.config().max_borrowed)
    }

    /// Whether all messages that the other side's window admits were sent. On a reliable link, they
    /// must also have been given back.
    pub(crate) fn is_flushed(&self) -> bool {
        // While a message waits for the window, more messages are in flight than the window admits.
        let admitted = match self.is_reliable() {
            true => 0,
            false => self.peer.contract.window() as usize,
        };
        !self.is_open()
            || (self.backlog.is_empty()
                && self.unsent.is_none()
                && self.machine.in_flight() <= admitted)
    }

    /// An upper bound for the messages that the application has not taken. They outlive the link.
    pub(crate) fn ready(&self) -> usize {
        self.machine.ready(&self.mapped)
    }

    /// Whether there may be a message to take.
    pub(super) fn is_ready(&self) -> bool {
        self.machine.is_ready(&self.mapped)
    }

    /// Sends the first packet.
    pub(super) fn start(&mut self, epoll: &Epoll, outbox: &mut Outbox) {
        self.drain(Incoming::default(), epoll, outbox);
    }

    /// Handles an event of the socket, which is readable, writable, or both.
    pub(super) fn on_event(&mut self, event: Event, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        if event.writable {
            self.flush(tools.epoll, outbox);
        }
        if event.readable {
            self.receive(BURST, tools, outbox);
        }
    }

    /// Reads all datagrams that the socket has, up to the number that a peer that obeys SPEC can
    /// have sent.
    pub(super) fn receive_all(&mut self, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        self.receive(LAST_WORDS, tools, outbox);
    }

    /// Reads at most `most` datagrams.
    fn receive(&mut self, most: usize, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        for _ in 0..most {
            let Some(socket) = &self.socket else { return };
            match receive(socket, tools.buffer) {
                Ok(incoming) => {
                    let bytes = &tools.buffer[..incoming.len];
                    self.datagram(bytes, incoming, tools.epoll, outbox);
                }
                Err(RecvError::WouldBlock) => return,
                //= SM2-TRN-006
                // `Closed` comes after all queued datagrams.
                Err(RecvError::Closed) => return self.feed(Input::Eof, tools.epoll, outbox),
                Err(RecvError::Io(error)) => {
                    tracing::warn!(link = %self.id, peer = %self.peer.name, %error, "link failed");
                    return self.feed(Input::Eof, tools.epoll, outbox);
                }
            }
        }
    }

    fn datagram(&mut self, bytes: &[u8], came: Incoming, epoll: &Epoll, outbox: &mut Outbox) {
        let datagram = Datagram {
            bytes,
            fds: &came.facts,
            data_truncated: came.data_truncated,
            control_truncated: came.control_truncated,
        };
        // If the datagram is a violation, the outputs report it.
        let _ = self
            .machine
            .handle(sm2_io::clock::now(), Input::Datagram(datagram));
        self.drain(came, epoll, outbox);
    }

    /// Feeds an input to the machine and carries out the outputs.
    pub(super) fn feed(&mut self, input: Input<'_>, epoll: &Epoll, outbox: &mut Outbox) {
        let result = self.machine.handle(sm2_io::clock::now(), input);
        debug_assert!(
            !matches!(result, Err(link::Error::Misuse(_))),
            "{result:?} on {}",
            self.id
        );
        self.drain(Incoming::default(), epoll, outbox);
    }

    /// Drops a message for this link alone, because its reliable deadline expired while this link
    /// had no room.
    //= SM2-QOS-002
    pub(super) fn skip(&mut self, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        debug_assert!(
            !self.has_room_for_backlog(),
            "what is latched fills all room"
        );
        if !self.has_room_for_backlog() && self.is_open() {
            self.feed(Input::Skip, tools.epoll, outbox);
            self.note_fates(tools.counting);
        }
    }

    /// Handles UNLINK: the Manager says that the other side is gone. Messages that the other side
    /// sent before still count.
    //= SM2-TRN-006, SM2-LNK-006
    pub(super) fn unlink(&mut self, code: Code, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        self.receive_all(tools, outbox);
        if self.end().is_none() {
            self.feed(Input::Close(code), tools.epoll, outbox);
        }
    }

    /// Carries out the outputs of the machine when no datagram was fed.
    pub(super) fn drain_idle(&mut self, epoll: &Epoll, outbox: &mut Outbox) {
        self.drain(Incoming::default(), epoll, outbox);
    }

    /// Takes the next message for the application. Returns it with the memory of its payload.
    #[inline]
    pub(super) fn take(
        &mut self,
        tools: &mut Tools<'_>,
        outbox: &mut Outbox,
    ) -> Result<Option<(Delivery, Source)>, TooManyBorrowed> {
        let Some(delivery) = self.take_next(tools, outbox)? else {
            return Ok(None);
        };
        let source = self.source(&delivery);
        self.held += 1;
        self.received.add(&delivery);
        if self.end().is_some() {
            self.forget_unused();
        }
        Ok(Some((delivery, source)))
    }

    #[inline]
    fn source(&mut self, delivery: &Delivery) -> Source {
        let found = match &delivery.payload {
            link::Payload::Inline(bytes) => Some(Source::Inline(bytes.clone())),
            link::Payload::Pooled { segment, offset } => {
                self.mapped.segments.get(segment).map(|it| Source::Pooled {
                    segment: Arc::clone(it),
                    offset: *offset,
                    len: delivery.len,
                })
            }
            link::Payload::Sealed => self.kept.remove(&delivery.sequence).map(|file| {
                let len = delivery.len;
                Source::Sealed { file, len }
            }),
        };
        debug_assert!(found.is_some(), "{delivery:?}");
        found.unwrap_or(Source::Missing)
    }

    /// Counts a message that the application gave back.
    pub(super) const fn note_released(&mut self) {
        self.held = self.held.saturating_sub(1);
    }

    /// The code that is reported to the Manager; `None` while the link is not over.
    pub(super) fn farewell(&self) -> Option<Code> {
        Some(match self.end()? {
            End::Local(code) | End::Peer(code) => code,
            End::Eof => Farewell::PeerGone.code(),
            End::Violation(violation) => violation.code(),
        })
    }
}
