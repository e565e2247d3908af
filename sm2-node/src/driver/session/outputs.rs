//! Carries out the outputs of the node's machine.

use std::io;
use std::sync::Arc;

use sm2_io::{Event, SeqPacket};
use sm2_proto::control::{Changes, LinkPeer, SchemaText};
use sm2_proto::link::Config;
use sm2_proto::node::{End, Input, Output};
use sm2_proto::{Farewell, InterfaceId, LinkId, Refusal};

use crate::driver::control::Control;
use crate::driver::datagram::Incoming;
use crate::driver::event_sets::NodeSets;
use crate::driver::interface::{DeclaredInterface, State};
use crate::driver::limits::BURST;
use crate::driver::link::LinkDriver;
use crate::driver::origin::Origin;
use crate::driver::questions::Questions;

impl Control {
    pub(in crate::driver) fn on_session_event(&mut self, event: Event, sets: &NodeSets) {
        self.session.begin_event();
        if event.writable {
            self.session.flush(sets);
        }
        if event.readable {
            for _ in 0..BURST {
                match self.session.receive(&mut self.buffer) {
                    Some(incoming) => self.drain_session(incoming, sets),
                    None => break,
                }
            }
        }
        if self.session.is_short_of_memory() {
            self.not_ready(&"no memory for the session");
        }
    }

    /// Carries out all outputs of the session's machine. Only this function matches them.
    pub(in crate::driver) fn drain_session(&mut self, mut came: Incoming, sets: &NodeSets) {
        while let Some(output) = self.session.poll() {
            match output {
                Output::Transmit(frame) => self.session.send(frame, None, sets),
                Output::TransmitCounters(frame) => match self.counting.descriptor() {
                    Ok(fd) => self.session.send(frame, Some(fd), sets),
                    Err(error) => {
                        tracing::warn!(%error, "tools will not see this node's counters");
                    }
                },
                Output::Welcomed { resuming, .. } => self.welcomed(resuming, sets),
                Output::HelloRefused(reason) => self.greeting_refused(reason),
                Output::Declared { interface, matches } => {
                    self.allowed_again(interface, sets);
                    self.answered(interface, State::Live { matches }, sets);
                }
                Output::DeclareRefused { interface, reason } => {
                    self.refused(interface, reason, sets);
                }
                Output::Linked {
                    interface,
                    link,
                    version,
                    qos,
                    peer,
                } => {
                    let terms = (link, version, qos.reliable, qos.sealed);
                    self.linked(interface, terms, peer, &mut came, sets);
                }
                Output::LinkLost {
                    interface,
                    link,
                    peer,
                } => self.link_lost(interface, link, &peer, sets),
                Output::Unlink {
                    interface,
                    link,
                    code,
                } => {
                    self.with_interface(interface, sets, |interface, context| {
                        interface.unlink(link, code, context);
                    });
                }
                Output::Withdrawn { .. } => {}
                Output::Page(page) => {
                    self.forget_due_links(sets);
                    let epoch = self.session.epoch().unwrap_or_default();
                    self.answer_came(|it| it.page_came(epoch, page));
                }
                Output::Changes(Changes {
                    revision,
                    changes,
                    more,
                }) => {
                    self.questions.changes(revision, changes.as_deref(), more);
                    self.sleepers.wake();
                }
                Output::Inspected { .. } => {
                    let file = came.take_fd();
                    self.answer_came(|it| it.counters_came(file));
                }
                Output::NotInspected { .. } => self.answer_came(|it| it.counters_came(None)),
                Output::Described { text, .. } => self.answer_came(|it| it.schema_came(text)),
                Output::Reloaded(outcome) => self.answer_came(|it| it.reload_came(outcome)),
                Output::Resumed => self.resumed(),
                Output::Ended(end) => self.ended(end, sets),
            }
        }
    }

    /// The answer to a question has come: the session asks the next one of its kind.
    fn answer_came(&mut self, take: impl FnOnce(&mut Questions) -> Option<Input<'static>>) {
        if let Some(input) = take(&mut self.questions) {
            self.session.tell(input);
        }
        self.sleepers.wake();
    }

    /// Handles a welcome. The first Manager knows all interfaces of this node at once, because
    /// there are none. Any other Manager knows them only when the session is
    /// [resumed](Self::resumed).
    fn welcomed(&mut self, resuming: bool, sets: &NodeSets) {
        self.session.refused = None;
        self.with_each_interface(sets, |interface| interface.refused_again = None);
        if self.counting.is_there() {
            self.session.tell(Input::Counters);
        }
        for (data, text) in &self.schemas {
            let (data, text) = (data.clone(), text.clone());
            self.session.tell(Input::Schema(SchemaText { data, text }));
        }
        self.state_links();
        if !resuming {
            self.connected();
        }
    }

    //= SM2-RES-001
    fn resumed(&mut self) {
        tracing::info!(node = %self.name, "there is a Manager again");
        self.connected();
    }

    fn connected(&mut self) {
        self.session.away = None;
        self.reconnect.done();
        self.sleepers.wake();
    }

    //= SM2-NOD-003
    // Links stay open after the end of the session.
    fn ended(&mut self, end: End, sets: &NodeSets) {
        self.session.hang_up(end, sets);
        self.questions.forget();
        self.forget_due_links(sets);
        self.come_back(end);
        self.sleepers.wake();
        self.session.log_end(end);
    }

    fn answered(&mut self, id: InterfaceId, state: State, sets: &NodeSets) {
        self.sleepers.wake();
        let written = self.with_interface(id, sets, |interface, _| {
            if let State::Live { matches } = state {
                interface.links.due = matches;
            }
            interface.state = state;
        });
        // The caller that declared the interface no longer waits for the answer. A refused
        // interface does not exist any more.
        if written.is_none() {
            self.session.tell(Input::Withdraw { interface: id });
        }
    }

    /// Changes all interfaces.
    fn with_each_interface(&mut self, sets: &NodeSets, change: impl Fn(&mut DeclaredInterface)) {
        let ids: Vec<_> = self.interfaces.keys().copied().collect();
        for id in ids {
            self.with_interface(id, sets, |interface, _| change(interface));
        }
    }

    /// Forgets the LINKs that were announced and have not come: they never come. Called at the end
    /// of a session, and with each PAGE. The Manager answers requests in order, so a PAGE after
    /// DECLARED also comes after the announced LINKs. For the missing ones the Manager had no
    /// descriptors.
    //= SM2-IFC-002
    fn forget_due_links(&mut self, sets: &NodeSets) {
        self.with_each_interface(sets, |interface| interface.links.due = 0);
    }

    fn refused(&mut self, id: InterfaceId, reason: Refusal, sets: &NodeSets) {
        let is_denial = reason.is_denial();
        let was_live = self.with_interface(id, sets, |interface, context| {
            let was_live = matches!(interface.state, State::Live { .. });
            if was_live {
                interface.refuse_again(reason.clone());
            }
            if is_denial {
                interface.discard_ended(context);
            }
            was_live
        });
        if was_live != Some(true) {
            self.answered(id, State::Refused(reason), sets);
        }
    }

    /// Another access policy allows an interface that the one before denied.
    //= SM2-ACC-013
    fn allowed_again(&mut self, id: InterfaceId, sets: &NodeSets) {
        self.with_interface(id, sets, |interface, _| {
            if interface.refused_again.take().is_some() {
                let (kind, name) = (interface.contract.kind(), interface.contract.name());
                tracing::info!(%kind, %name, "this interface has its rights again");
            }
        });
    }

    /// Counts a LINK whose socket was lost. The machine has told the Manager.
    //= SM2-TRN-011
    fn link_lost(&mut self, id: InterfaceId, link: LinkId, peer: &LinkPeer, sets: &NodeSets) {
        self.with_interface(id, sets, |interface, _| {
            interface.links.link_came();
        });
        if let Some(count) = self.links_lost.count(sm2_io::clock::now()) {
            tracing::warn!(
                %link,
                peer = %peer.name,
                count,
                "no free descriptor for a link: raise the limit of open files (ulimit -n); the Manager tries again"
            );
        }
        self.ran_out_of_links();
    }

    /// Adds a link whose socket came with LINK.
    fn linked(
        &mut self,
        id: InterfaceId,
        (link, version, reliable, sealed): (LinkId, u16, bool, bool),
        peer: LinkPeer,
        came: &mut Incoming,
        sets: &NodeSets,
    ) {
        let Some(interface) = self.interfaces.get(&id).map(Arc::downgrade) else {
            return;
        };
        let token = self.last_token.next();
        self.last_token = token;
        self.routes.insert(token, id);
        let mut entry = self.counting.allocate(id, Some(link));
        let quota = self.mappings.peer(link.epoch, peer.node);
        let (ring, room) = (self.ring_lane, self.link_room.hold());
        let origin = Arc::new(Origin {
            token,
            peer: Arc::new(peer),
            interface,
        });
        let socket = (came.take_fd())
            .ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))
            .and_then(SeqPacket::from_fd);
        let added = self.with_interface(id, sets, |interface, context| {
            interface.links.link_came();
            let socket = socket?;
            // Under the lock, so that a call that wakes for the socket finds the link.
            context.sets.add_link(&socket, token)?;
            let config = Config {
                ring,
                max_len: interface.max_len,
                publications: interface.absence.publications(interface.published),
                ..Config::new(&interface.contract, link, version, reliable, sealed)
                    .with_peer(&origin.peer.contract)
            };
            let (origin, entry) = (Arc::clone(&origin), entry.take());
            let driver = LinkDriver::new(origin, (socket, room), config, entry, quota);
            interface.add_link(driver, context);
            Ok::<_, io::Error>(())
        });
        if let Some(Err(error)) = added {
            self.routes.remove(&token);
            if let Some(entry) = entry {
                self.counting.free(entry);
            }
            self.session.unlinked(id, link, Farewell::Resources.code());
            tracing::warn!(%link, peer = %origin.peer.name, %error, "cannot use the link's socket");
        }
        self.state_links();
    }
}
