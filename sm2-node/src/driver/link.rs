//! One end of one link: its socket, its machine, and the memory that was mapped for it.
//!
//! No function in this module waits. If the socket is full, the driver keeps one packet and stops
//! the machine from transmitting. A failure ends only the link where it occurs.

mod account;
mod cells;
mod counting;
mod mapped;
mod qos;
mod road;
mod send;
mod socket;
mod take;
mod wire;

use std::collections::{BTreeSet, HashMap, VecDeque};
use std::sync::Arc;

use sm2_io::memfd::SealedFile;
use sm2_io::{CounterEntry, Ring, SeqPacket};
use sm2_proto::link::{self, At, Counters, End, Link, Role};
use sm2_proto::{Code, Farewell, Instant, LinkId};

use self::account::LinkAccount;
use self::cells::Cells;
use self::counting::LinkCounting;
use self::mapped::{Mapped, make_ring};
use self::wire::Wire;
use super::counters::update;
use super::event_sets::LinkSets;
use super::origin::Origin;
use super::outbox::{MessageKey, Needs};
use super::status::{LinkStatus, Received};
use super::token::LinkToken;
use crate::link_room::HeldLink;
use crate::quota::PeerQuota;

#[derive(Debug)]
pub(crate) struct LinkDriver {
    pub(crate) id: LinkId,
    pub(crate) origin: Arc<Origin>,
    /// The socket, until the link is over.
    wire: Option<Wire>,
    machine: Link,
    /// The rings and segments that both sides map.
    mapped: Mapped,
    /// The copies of messages that came in cells.
    cells: Cells,
    /// The bytes that may be mapped for the peer.
    quota: Arc<PeerQuota>,
    /// The files of sealed messages that were not taken yet, by sequence number.
    kept: HashMap<u64, SealedFile>,
    pub(super) backlog: Backlog,
    /// Whether the interface knows that the link is over.
    pub(super) end_noticed: bool,
    /// How many messages the receiver had released when the link was suspended (SM2-QOS-007).
    suspended: Option<u64>,
    /// How many messages the application holds.
    held: usize,
    received: Received,
    /// The losses before messages that have expired since the last message that was taken.
    lost_with_expired: u64,
    /// The account of messages that were published while there was no link.
    account: LinkAccount,
    /// Whether the program knows that the link has opened, and not that it has ended.
    pub(super) has_joined: bool,
    pub(super) counting: LinkCounting,
    pub(super) calls: LinkCalls,
    /// Whether the access policy denies the link.
    denied: bool,
}

/// Messages that have not been sent on a link yet: those of the latched store, and publications that wait until the
/// socket accepts the ATTACH of their segment.
#[derive(Debug, Default)]
pub(super) struct Backlog {
    pub(super) keys: VecDeque<MessageKey>,
    /// Whether the latched messages were put here, once the link was open.
    pub(super) is_filled: bool,
}

/// The calls of a caller's link or of a server's link.
#[derive(Debug, Default)]
pub(super) struct LinkCalls {
    /// Caller: the number of the last call.
    pub(super) last: u64,
    /// Caller: calls that failed with the link and were not reported yet.
    pub(super) failed: Vec<u64>,
    /// Server: calls that their client no longer wants.
    pub(super) cancelled: BTreeSet<u64>,
}

impl LinkDriver {
    pub(super) fn new(
        origin: Arc<Origin>,
        socket: (SeqPacket, HeldLink),
        mut config: link::Config,
        mut entry: Option<CounterEntry>,
        quota: Arc<PeerQuota>,
    ) -> Self {
        if config.role == Role::Receiver {
            update(entry.as_mut(), |entry| {
                entry.max_held(config.max_borrowed.into())
            });
        }
        let mut mapped = Mapped::default();
        let own_ring = make_ring(&mut config, &mut mapped);
        let token = origin.token;
        Self {
            id: config.id,
            origin,
            wire: Some(Wire::new(socket, token, own_ring)),
            machine: Link::new(config),
            mapped,
            cells: Cells::default(),
            quota,
            kept: HashMap::new(),
            backlog: Backlog::default(),
            end_noticed: false,
            suspended: None,
            held: 0,
            received: Received::default(),
            lost_with_expired: 0,
            account: LinkAccount::default(),
            has_joined: false,
            counting: LinkCounting::new(entry),
            calls: LinkCalls::default(),
            denied: false,
        }
    }

    /// The access policy denies the link.
    pub(super) const fn deny(&mut self) {
        self.denied = true;
    }

    /// Whether the access policy denies the link, as the Manager or the other side says: its messages
    /// that were not taken are discarded.
    //= SM2-ACC-014
    pub(super) fn is_denied(&self) -> bool {
        self.denied || self.end_code() == Some(Farewell::Denied.code())
    }

    #[inline]
    pub(crate) fn token(&self) -> LinkToken {
        self.origin.token
    }

    pub(crate) fn is_open(&self) -> bool {
        self.machine.is_open()
    }

    /// Whether the link is neither open nor over.
    pub(crate) fn is_opening(&self) -> bool {
        !self.is_open() && self.end().is_none()
    }

    #[inline]
    pub(crate) fn end(&self) -> Option<End> {
        self.machine.end()
    }

    /// Whether the link is over, and its interface does not know that yet.
    #[inline]
    pub(super) fn is_over_unnoticed(&self) -> bool {
        self.machine.end().is_some() && !self.end_noticed
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

    pub(crate) fn owes(&self) -> bool {
        self.machine.owes()
    }

    /// The length of the longest message that the other side accepts, in bytes.
    #[inline]
    pub(crate) const fn peer_max_len(&self) -> u64 {
        self.machine.peer_max_len()
    }

    /// Whether the other side accepts messages of this length.
    //= SM2-QOS-008, SM2-SRV-006, SM2-SRV-007
    #[inline]
    pub(crate) const fn accepts(&self, len: u64) -> bool {
        len <= self.peer_max_len()
    }

    pub(super) fn role(&self) -> Role {
        self.machine.config().role
    }

    /// The forms of messages that this link accepts.
    pub(crate) fn needs(&self) -> Needs {
        self.machine.placement().into()
    }

    /// Whether one more message would be sent or queued without loss.
    pub(crate) fn has_room(&self) -> bool {
        self.backlog.keys.is_empty() && self.has_room_for_backlog()
    }

    /// The same as [`has_room`](Self::has_room), for messages of the backlog, which are sent first.
    pub(super) fn has_room_for_backlog(&self) -> bool {
        !self.is_suspended() && self.machine.has_room(&self.mapped)
    }

    /// Whether a publication waits for this link, which wants every message: it has no room and does not owe.
    //= SM2-QOS-002, SM2-QOS-003
    #[inline]
    pub(super) fn delays_publication(&self) -> bool {
        self.is_open() && self.is_reliable() && !self.has_room() && !self.owes()
    }

    /// Whether the kernel had no memory for the last packet, or to read the socket.
    pub(super) const fn is_short_of_memory(&self) -> bool {
        matches!(&self.wire, Some(wire) if wire.is_short_of_memory)
    }

    /// Whether the socket has not accepted a packet.
    const fn has_unsent(&self) -> bool {
        matches!(&self.wire, Some(wire) if wire.unsent.is_some())
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
            false => self.origin.peer.contract.window() as usize,
        };
        !self.is_open()
            || (self.backlog.keys.is_empty()
                && !self.has_unsent()
                && self.machine.in_flight() <= admitted)
    }

    /// Counts a message that was sent at `now`.
    #[inline]
    fn count_sent(&mut self, time: Instant, len: u64, now: Instant) {
        let (role, counters) = (self.role(), self.counters());
        (self.counting).count_sent(role, &counters, (time, len), now);
    }

    /// Writes the outcomes of messages to the entry, if they have changed.
    pub(super) fn write_fates(&mut self) {
        let counters = self.counters();
        self.counting.write_fates(&counters);
    }

    /// How many more messages of a publisher the other side does not get than at the last call. Messages whose fate
    /// the end of the link hides are not among them.
    pub(super) fn take_new_drops(&mut self) -> u64 {
        if self.role() != Role::Sender {
            return 0;
        }
        let counters = self.counters();
        self.counting.take_new_drops(&counters)
    }

    /// Whether each message makes the link's socket readable.
    pub(crate) const fn is_woken_by_socket(&self) -> bool {
        self.machine.is_woken_by_socket()
    }

    /// The ring and its word that the next message fills, if this link receives through a ring.
    pub(super) fn next_word(&self) -> Option<(Arc<Ring>, At)> {
        let word = self.machine.next_word()?;
        Some((Arc::clone(self.mapped.incoming.as_ref()?), word))
    }

    /// Prefetches the next message, if this link receives through a ring.
    #[inline]
    pub(super) fn prefetch(&self) {
        self.machine.prefetch(&self.mapped);
    }

    /// Announces that a thread is about to sleep until this link has an event.
    //= SM2-RNG-012
    pub(super) fn park(&self) {
        if self.machine.end().is_none() {
            self.machine.park(&self.mapped);
        }
    }

    /// Whether the link is opening, or messages wait for packets of the other side. The control side reads such a link.
    /// Calls of the program read DATA and RELEASE, so these packets do not wake the background thread.
    fn awaits_packets(&self) -> bool {
        self.is_opening() || self.machine.has_queued() || !self.backlog.keys.is_empty()
    }

    /// Wakes the background thread for the events that it has to handle from now on.
    #[inline]
    pub(super) fn watch_in_background(&mut self, sets: &LinkSets) {
        let awaits_packets = self.awaits_packets();
        if let Some(wire) = &mut self.wire {
            wire.watch_in_background(awaits_packets, sets);
        }
    }

    /// Called when the background thread has handled an event.
    pub(super) fn after_background_event(&mut self, sets: &LinkSets) {
        let awaits_packets = self.awaits_packets();
        if let Some(wire) = &mut self.wire {
            wire.after_background_event(awaits_packets, sets);
        }
    }

    /// An upper bound for the messages that the application has not taken. They outlive the link.
    pub(crate) fn untaken(&self) -> usize {
        self.machine.untaken(&self.mapped)
    }

    /// Whether there may be a message to take.
    pub(super) fn may_take(&self) -> bool {
        self.machine.may_take(&self.mapped)
    }

    /// Whether nothing follows from a message that was sent or released on this link. At a receiver's end, that is so
    /// until the link is over. Elsewhere on the socket lane something may, because a call may have read the socket.
    pub(super) fn is_settled(&self) -> bool {
        let is_idle = || !self.is_woken_by_socket() && !self.machine.has_queued();
        self.end().is_none() && (self.role() == Role::Receiver || is_idle())
    }

    /// The code that is reported to the Manager; `None` while the link is not over.
    pub(super) fn end_code(&self) -> Option<Code> {
        Some(match self.end()? {
            End::Local(code) | End::Peer(code) => code,
            End::Eof => Farewell::PeerGone.code(),
            End::Violation(violation) => violation.code(),
        })
    }

    /// The state of the link for a program.
    pub(super) fn status(&self) -> LinkStatus {
        LinkStatus {
            id: self.id,
            peer: Arc::clone(&self.origin.peer),
            open: self.is_open(),
            reliable: self.is_reliable(),
            sealed: self.is_sealed(),
            ring: self.machine.lane() == link::LaneKind::Ring,
            short_of_memory: self.is_short_of_memory(),
            counters: self.counters(),
            received: Received {
                away: self.account.away(),
                ..self.received
            },
            missed_deadlines: self.qos_watch().missed_deadlines(),
            alive: self.qos_watch().is_alive(),
            lost_liveliness: self.qos_watch().lost_liveliness(),
            end: self.end(),
        }
    }
}
