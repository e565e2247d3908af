//! The state of a node that changes.

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::path::PathBuf;

use sm2_io::{Event, Events, Scratch, SeqPacket};
use sm2_proto::limits::DATAGRAM_MAX;
use sm2_proto::{Instant, InterfaceId, Name, TypeId};

use super::counters::Counting;
use super::event_sets::EventSets;
use super::interface::Interface;
use super::limited_warning::LimitedWarning;
use super::limits::SOCKETS;
use super::questions::Questions;
use super::session::{Reconnect, Session};
use super::sleepers::Sleepers;
use super::token::LinkToken;
use crate::link_room::LinkRoom;
use crate::quota::MappingQuota;

/// The state of a node that changes, under the lock.
#[derive(Debug)]
pub(crate) struct Inner {
    pub(super) name: Name,
    /// Whether links offer the ring lane.
    pub(super) ring_lane: bool,
    /// The bytes that may be mapped for peers.
    pub(super) mappings: MappingQuota,
    /// How many links this node can have.
    pub(super) link_room: LinkRoom,
    pub(super) session: Session,
    pub(super) reconnect: Reconnect,
    pub(super) questions: Questions,
    pub(super) counting: Counting,
    /// The schema texts that this node registers with each Manager, by type.
    pub(super) schemas: BTreeMap<TypeId, String>,
    pub(crate) interfaces: BTreeMap<InterfaceId, Interface>,
    /// The interface that each link belongs to.
    pub(super) routes: HashMap<LinkToken, InterfaceId>,
    /// The warnings about links whose sockets were lost.
    pub(super) links_lost: LimitedWarning,
    /// The warnings about a shortage of memory.
    pub(super) shortages: LimitedWarning,
    /// Whether a socket was ready in the last drive, but the kernel had no memory to use it. The socket is still
    /// ready, so a thread that waits for it pauses first (SM2-TRN-014).
    pub(super) short_of_memory: bool,
    /// The token of the newest link.
    pub(super) last_token: LinkToken,
    pub(super) buffer: Scratch,
    pub(super) events: Events,
    pub(super) ready: Vec<Event>,
    pub(super) sleepers: Sleepers,
    /// The time of the last drive.
    pub(super) last_drive: Instant,
    /// The time at which the current API call began.
    pub(super) now: Instant,
}

impl Inner {
    /// Creates the state of a node whose Manager is at the other end of `socket`.
    pub(super) fn new(
        socket: SeqPacket,
        path: PathBuf,
        name: Name,
        ring_lane: bool,
        mappings: MappingQuota,
        sets: &EventSets,
    ) -> io::Result<Self> {
        Ok(Self {
            name: name.clone(),
            ring_lane,
            mappings,
            link_room: LinkRoom::new(),
            session: Session::new(socket, name),
            reconnect: Reconnect::new(path, sets)?,
            questions: Questions::default(),
            counting: Counting::default(),
            schemas: BTreeMap::new(),
            interfaces: BTreeMap::new(),
            routes: HashMap::new(),
            links_lost: LimitedWarning::default(),
            shortages: LimitedWarning::default(),
            short_of_memory: false,
            last_token: LinkToken::FIRST,
            buffer: Scratch::new(DATAGRAM_MAX)?,
            events: Events::with_capacity(SOCKETS),
            ready: Vec::with_capacity(SOCKETS),
            sleepers: Sleepers::new()?,
            last_drive: Instant(0),
            now: Instant(0),
        })
    }
}
