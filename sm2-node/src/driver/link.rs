//! One end of one link: socket, machine, and what was mapped for it.
//!
//! Nothing here waits. A socket that takes no more keeps one packet here and stops
//! the machine's transmitting; whatever fails ends this link and no other.

mod outputs;

use std::collections::{BTreeSet, HashMap, VecDeque};
use std::os::fd::OwnedFd;
use std::sync::Arc;

use sm2_io::memfd::SealedFile;
use sm2_io::{CounterEntry, Epoll, Event, RecvError, Ring, SeqPacket};
use sm2_proto::control::Peer;
use sm2_proto::link::{self, Counters, Delivery, End, Input, Link, Packet, Role, TooManyBorrowed};
use sm2_proto::{Code, Datagram, Farewell, Instant, LinkId};

use super::BURST;
use super::counters::Counting;
use super::datagram::{Incoming, receive};
use super::lane::{Mapped, prepare_ring};
use super::message_key::MessageKey;
use super::outbox::{Needs, Outbox};
use super::status::Received;
use super::token::LinkToken;
use crate::payload::Source;

/// How many datagrams are read from a link whose other side is gone: more than a window
/// full of messages, each with its segment.
const LAST_WORDS: usize = 8_192;

#[derive(Debug)]
pub(crate) struct LinkDriver {
    pub(crate) id: LinkId,
    pub(crate) peer: Arc<Peer>,
    token: LinkToken,
    pub(super) socket: Option<SeqPacket>,
    pub(super) machine: Link,
    /// The rings and segments that both sides map.
    pub(super) mapped: Mapped,
    /// A ring for messages to this side and its file, until both ends have agreed on a lane.
    pub(super) prepared: Option<(Ring, OwnedFd)>,
    /// The file of the incoming ring, until the other side has it.
    pub(super) ring_file: Option<OwnedFd>,
    /// The packet that the socket did not take.
    unsent: Option<Packet>,
    /// Sealed files of messages that were not taken yet, by sequence.
    kept: HashMap<u64, SealedFile>,
    /// Messages of the latched store that have not been sent on this link yet.
    pub(super) backlog: VecDeque<MessageKey>,
    /// Whether the interface knows that the link is open.
    pub(super) greeted: bool,
    /// Whether the interface knows that the link is over.
    pub(super) buried: bool,
    /// Messages that the application holds.
    held: usize,
    pub(super) received: Received,
    /// Where its counters are, as long as it is not buried.
    pub(super) entry: Option<CounterEntry>,
    /// What stands there.
    pub(super) noted: Counters,
    /// Caller: the number of the last call.
    pub(super) last_call: u64,
    /// Caller: calls that failed with the link, not reported yet.
    pub(super) failed: Vec<u64>,
    /// Server: calls that their client no longer wants.
    pub(super) cancelled: BTreeSet<u64>,
    /// Why the link has to be ended from this side.
    failing: Option<Code>,
}

/// What the methods of a link need of the node.
pub(crate) struct Tools<'a> {
    pub(crate) epoll: &'a Epoll,
    pub(crate) buffer: &'a mut [u8],
    pub(crate) counting: &'a mut Counting,
    /// When the call began that waits, takes or publishes; long ago for all others.
    pub(crate) now: Instant,
    /// Whether a socket of the interface was read meanwhile, of which sleepers wait to hear.
    pub(crate) stirred: bool,
}

impl LinkDriver {
    pub(super) fn new(
        token: LinkToken,
        peer: Arc<Peer>,
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

    /// The form in which this link takes messages.
    pub(crate) fn needs(&self) -> Needs {
        self.machine.placement().into()
    }

    /// Whether one more message would be sent or queued without loss.
    pub(crate) fn has_room(&self) -> bool {
        self.backlog.is_empty() && self.has_room_for_backlog()
    }

    /// The same for what is to be sent before all else.
    pub(super) fn has_room_for_backlog(&self) -> bool {
        self.machine.has_room(&self.mapped)
    }

    /// Calls without a reply, and messages that the application holds.
    pub(crate) fn calls(&self) -> usize {
        self.machine.calls()
    }

    pub(crate) const fn held(&self) -> usize {
        self.held
    }

    pub(crate) fn max_borrowed(&self) -> usize {
        usize::from(self.machine.config().max_borrowed)
    }

    /// Whether all is sent that the other side's window admits, and on a reliable link also
    /// given back.
    pub(crate) fn is_flushed(&self) -> bool {
        // More are in flight than the window admits as long as one waits for it.
        let admitted = match self.is_reliable() {
            true => 0,
            false => self.peer.contract.window() as usize,
        };
        !self.is_open()
            || (self.backlog.is_empty()
                && self.unsent.is_none()
                && self.machine.in_flight() <= admitted)
    }

    /// How many messages the application has not taken. They outlive the link.
    pub(crate) fn ready(&self) -> usize {
        self.machine.ready(&self.mapped)
    }

    /// Whether there may be one.
    pub(super) fn is_ready(&self) -> bool {
        self.machine.is_ready(&self.mapped)
    }

    /// Sends the first packet.
    pub(super) fn start(&mut self, epoll: &Epoll, outbox: &mut Outbox) {
        self.drain(Incoming::default(), epoll, outbox);
    }

    /// The socket is readable, writable, or both.
    pub(super) fn on_event(&mut self, event: Event, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        if event.writable {
            self.flush(tools.epoll, outbox);
        }
        if event.readable {
            self.receive(BURST, tools, outbox);
        }
    }

    /// Reads all that is there, as far as an honest peer can have sent it.
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
                // Only now: `Closed` comes after all that was queued.
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
        // What is wrong with it is said by the outputs.
        let _ = self
            .machine
            .handle(sm2_io::clock::now(), Input::Datagram(datagram));
        self.drain(came, epoll, outbox);
    }

    /// Gives the machine an input, and does what it says.
    pub(super) fn feed(&mut self, input: Input<'_>, epoll: &Epoll, outbox: &mut Outbox) {
        let result = self.machine.handle(sm2_io::clock::now(), input);
        debug_assert!(
            !matches!(result, Err(link::Error::Misuse(_))),
            "{result:?} on {}",
            self.id
        );
        self.drain(Incoming::default(), epoll, outbox);
    }

    /// This message goes without this link, which was waited for in vain.
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

    /// The other side is gone, says the Manager: what it sent before counts.
    //= SM2-TRN-006, SM2-LNK-006
    pub(super) fn unlink(&mut self, code: Code, tools: &mut Tools<'_>, outbox: &mut Outbox) {
        self.receive_all(tools, outbox);
        if self.end().is_none() {
            self.feed(Input::Close(code), tools.epoll, outbox);
        }
    }

    /// Does what the machine says without a datagram.
    pub(super) fn drain_idle(&mut self, epoll: &Epoll, outbox: &mut Outbox) {
        self.drain(Incoming::default(), epoll, outbox);
    }

    /// The next message for the application, and where it is.
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

    /// The application holds one message less.
    pub(super) const fn note_released(&mut self) {
        self.held = self.held.saturating_sub(1);
    }

    /// The code that the Manager is told, once the link is over.
    pub(super) fn farewell(&self) -> Option<Code> {
        Some(match self.end()? {
            End::Local(code) | End::Peer(code) => code,
            End::Eof => Farewell::PeerGone.code(),
            End::Violation(violation) => violation.code(),
        })
    }
}
