//! The state of a node's control side.

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use sm2_io::{Event, Events, Scratch, SeqPacket};
use sm2_proto::limits::DATAGRAM_MAX;
use sm2_proto::{InterfaceId, Name, TypeId};

use super::context::Context;
use super::counters::Counting;
use super::datagram::Incoming;
use super::event_sets::NodeSets;
use super::interface::{DeclaredInterface, ForControl};
use super::leftovers::Leftovers;
use super::limited_warning::LimitedWarning;
use super::limits::SOCKETS;
use super::qos_timer::QosTimer;
use super::questions::Questions;
use super::session::{Reconnect, SessionDriver};
use super::shared_interface::SharedInterface;
use super::sleepers::Sleepers;
use super::token::LinkToken;
use crate::link_room::LinkRoom;
use crate::quota::MappingQuota;

/// The state of a node's control side, under the node's lock.
///
/// A thread that holds this lock may lock an interface. A thread that has locked an interface never takes this lock.
#[derive(Debug)]
pub(crate) struct Control {
    pub(super) name: Name,
    /// Whether links offer the ring lane.
    pub(super) ring_lane: bool,
    /// The bytes that may be mapped for peers.
    pub(super) mappings: MappingQuota,
    /// How many links this node can have.
    pub(super) link_room: LinkRoom,
    pub(super) session: SessionDriver,
    pub(super) reconnect: Reconnect,
    pub(super) qos_timer: QosTimer,
    pub(super) questions: Questions,
    pub(super) counting: Counting,
    /// The schema texts that this node registers with each Manager, by type.
    pub(super) schemas: BTreeMap<TypeId, String>,
    pub(super) interfaces: BTreeMap<InterfaceId, Arc<SharedInterface>>,
    /// The interface that each link belongs to.
    pub(super) routes: HashMap<LinkToken, InterfaceId>,
    /// The warnings about links whose sockets were lost.
    pub(super) links_lost: LimitedWarning,
    /// The warnings about a shortage of memory.
    pub(super) shortages: LimitedWarning,
    /// Whether a descriptor was ready in the last drive, but the kernel had no memory to use it. The descriptor is
    /// still ready, so a thread that waits for it pauses first (SM2-TRN-013).
    pub(super) short_of_memory: bool,
    /// The token of the newest link.
    pub(super) last_token: LinkToken,
    pub(super) buffer: Scratch,
    pub(super) events: Events,
    pub(super) ready: Vec<Event>,
    /// Memory of messages that goes back to the system.
    pub(super) leftovers: Leftovers,
    /// The threads that wait for the session.
    pub(super) sleepers: Sleepers,
}

impl Control {
    /// Creates the state of a node whose Manager is at the other end of `socket`.
    pub(super) fn new(
        socket: SeqPacket,
        path: PathBuf,
        name: Name,
        ring_lane: bool,
        mappings: MappingQuota,
        sets: &NodeSets,
    ) -> io::Result<Self> {
        Ok(Self {
            name: name.clone(),
            ring_lane,
            mappings,
            link_room: LinkRoom::new(),
            session: SessionDriver::new(socket, name),
            reconnect: Reconnect::new(path, sets)?,
            qos_timer: QosTimer::default(),
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
            leftovers: Leftovers::default(),
            sleepers: Sleepers::new(&sets.wakers),
        })
    }

    /// Whether a link of the node is being opened.
    pub(crate) fn is_opening(&self) -> bool {
        let mut interfaces = self.interfaces.values();
        interfaces.any(|it| it.lock().interface().links.is_opening())
    }

    /// Changes an interface, wakes the threads that wait for it, and handles the results. `None` if the interface
    /// does not exist any more.
    pub(super) fn with_interface<R>(
        &mut self,
        id: InterfaceId,
        sets: &NodeSets,
        change: impl FnOnce(&mut DeclaredInterface, &mut Context<'_>) -> R,
    ) -> Option<R> {
        let interface = Arc::clone(self.interfaces.get(&id)?);
        let (result, for_control) = interface.change_from_control(change);
        if let Some(for_control) = for_control {
            self.handle(id, for_control, sets);
        }
        Some(result)
    }

    /// Handles the results of a call of an interface.
    pub(super) fn handle(&mut self, id: InterfaceId, results: ForControl, sets: &NodeSets) {
        let ForControl {
            ends,
            gone,
            freed,
            wants_page,
            tick_at,
            leftovers,
        } = results;
        if !leftovers.is_empty() {
            self.leftovers.add(leftovers, sets);
        }
        for token in gone {
            self.routes.remove(&token);
        }
        for entry in freed {
            self.counting.free(entry);
        }
        if let Some(at) = tick_at {
            self.qos_timer.tick_at(id, at);
        }
        // The Manager sends a PAGE after the frames that are on their way now.
        if wants_page
            && self.session.is_ready()
            && let Some(input) = self.questions.expect_page()
        {
            self.session.tell(input);
            self.drain_session(Incoming::default(), sets);
        }
        if !ends.is_empty() {
            for (link, code) in ends {
                self.session.unlinked(id, link, code);
            }
            self.drain_session(Incoming::default(), sets);
        }
    }
}
