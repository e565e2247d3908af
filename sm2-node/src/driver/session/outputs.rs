//! Carries out the outputs of the node's machine.

use std::io;
use std::sync::Arc;

use sm2_io::{Event, SeqPacket};
use sm2_proto::control::{Changes, LinkPeer, Page, SchemaText};
use sm2_proto::link::Config;
use sm2_proto::node::{End, Input, Output};
use sm2_proto::{Farewell, InterfaceId, LinkId, Refusal};

use crate::driver::datagram::Incoming;
use crate::driver::event_sets::EventSets;
use crate::driver::inner::Inner;
use crate::driver::interface::{Interface, State};
use crate::driver::limits::BURST;
use crate::driver::link::LinkDriver;
use crate::driver::sleepers::EventSource;

impl Inner {
    pub(in crate::driver) fn on_session_event(&mut self, event: Event, sets: &EventSets) {
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
    pub(in crate::driver) fn drain_session(&mut self, mut came: Incoming, sets: &EventSets) {
        while let Some(output) = self.session.poll() {
            match output {
                Output::Transmit(frame) => self.session.send(frame, None, sets),
                Output::TransmitCounters(frame) => match self.counting.descriptor() {
                    Ok(fd) => self.session.send(frame, Some(fd), sets),
                    Err(error) => {
                        tracing::warn!(%error, "tools will not see this node's counters");
                    }
                },
                Output::Welcomed { resuming, .. } => self.welcomed(resuming),
                Output::HelloRefused(reason) => self.greeting_refused(reason),
                Output::Declared { interface, matches } => {
                    self.allowed_again(interface);
                    self.answered(interface, State::Live { matches });
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
                } => self.link_lost(interface, link, &peer),
                Output::Unlink {
                    interface,
                    link,
                    code,
                } => {
                    self.with_interface(interface, sets, |interface, context| {
                        interface.unlink(link, code, context);
                    });
                    self.sleepers.wake(EventSource::Interface(interface));
                }
                Output::Withdrawn { .. } => {}
                Output::Page(Page {
                    revision,
                    items,
                    next,
                }) => {
                    self.forget_due_links();
                    self.page_came(revision, items, next);
                }
                Output::Changes(Changes {
                    revision,
                    changes,
                    more,
                }) => self.changes_came(revision, changes.as_deref(), more),
                Output::Inspected { .. } => self.counters_came(came.take_fd()),
                Output::NotInspected { .. } => self.counters_came(None),
                Output::Described { text, .. } => self.schema_came(text),
                Output::Reloaded(outcome) => self.reload_came(outcome),
                Output::Resumed => self.resumed(),
                Output::Ended(end) => self.ended(end, sets),
            }
        }
    }

    /// Handles a welcome. The first Manager knows all interfaces of this node at once, because
    /// there are none. Any other Manager knows them only when the session is
    /// [resumed](Self::resumed).
    fn welcomed(&mut self, resuming: bool) {
        self.session.refused = None;
        for interface in self.interfaces.values_mut() {
            interface.refused_again = None;
        }
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
        self.sleepers.wake(EventSource::Session);
    }

    //= SM2-NOD-003
    // Links stay open after the end of the session.
    fn ended(&mut self, end: End, sets: &EventSets) {
        self.session.hang_up(end, sets);
        self.questions.forget();
        self.forget_due_links();
        self.come_back(end);
        self.sleepers.wake(EventSource::Session);
        self.session.log_end(end);
    }

    fn answered(&mut self, id: InterfaceId, state: State) {
        match self.interfaces.get_mut(&id) {
            Some(interface) => {
                if let State::Live { matches } = state {
                    interface.links_due = matches;
                }
                interface.state = state;
            }
            // The caller that declared the interface no longer waits for the answer. A refused
            // interface does not exist any more.
            None => self.session.tell(Input::Withdraw { interface: id }),
        }
        self.sleepers.wake(EventSource::Interface(id));
    }

    /// Forgets the LINKs that were announced and have not come: they never come. Called at the end
    /// of a session, and with each PAGE. The Manager answers requests in order, so a PAGE after
    /// DECLARED also comes after the announced LINKs. For the missing ones the Manager had no
    /// descriptors.
    //= SM2-IFC-002
    fn forget_due_links(&mut self) {
        for interface in self.interfaces.values_mut() {
            interface.links_due = 0;
        }
    }

    fn refused(&mut self, id: InterfaceId, reason: Refusal, sets: &EventSets) {
        let is_denial = reason.is_denial();
        match self.interfaces.get_mut(&id) {
            //= SM2-RES-011, SM2-ACC-013
            Some(interface) if matches!(interface.state, State::Live { .. }) => {
                let (kind, name) = (interface.contract.kind(), interface.contract.name());
                match is_denial {
                    _ if interface.refused_again.is_some() => {}
                    true => {
                        tracing::warn!(%kind, %name, %reason, "this interface lost its rights: its links end")
                    }
                    false => tracing::warn!(
                        %kind, %name, %reason,
                        "the new Manager refused this interface: its links stay open, but it gets no new ones"
                    ),
                }
                interface.refused_again = Some(reason);
            }
            _ => self.answered(id, State::Refused(reason)),
        }
        if is_denial {
            self.with_interface(id, sets, Interface::discard_ended);
            self.sleepers.wake(EventSource::Interface(id));
        }
    }

    /// Another access policy allows an interface that the one before denied.
    //= SM2-ACC-013
    fn allowed_again(&mut self, id: InterfaceId) {
        if let Some(interface) = self.interfaces.get_mut(&id)
            && interface.refused_again.take().is_some()
        {
            let (kind, name) = (interface.contract.kind(), interface.contract.name());
            tracing::info!(%kind, %name, "this interface has its rights again");
        }
    }

    /// Counts a LINK whose socket was lost. The machine has told the Manager.
    //= SM2-TRN-012
    fn link_lost(&mut self, id: InterfaceId, link: LinkId, peer: &LinkPeer) {
        if let Some(count) = self.links_lost.note(sm2_io::clock::now()) {
            tracing::warn!(
                %link,
                peer = %peer.name,
                count,
                "no free descriptor for a link: raise the limit of open files (ulimit -n); the Manager tries again"
            );
        }
        if let Some(interface) = self.interfaces.get_mut(&id) {
            interface.links_due = interface.links_due.saturating_sub(1);
        }
        self.ran_out_of_links();
        self.sleepers.wake(EventSource::Interface(id));
    }

    /// Adds a link whose socket came with LINK.
    fn linked(
        &mut self,
        id: InterfaceId,
        (link, version, reliable, sealed): (LinkId, u16, bool, bool),
        peer: LinkPeer,
        came: &mut Incoming,
        sets: &EventSets,
    ) {
        let Some(interface) = self.interfaces.get_mut(&id) else {
            return;
        };
        interface.links_due = interface.links_due.saturating_sub(1);
        let token = self.last_token.next();
        let socket = (came.take_fd())
            .ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))
            .and_then(SeqPacket::from_fd)
            .and_then(|socket| {
                sets.add_link(&socket, token)?;
                Ok(socket)
            });
        match socket {
            Ok(socket) => {
                let config = Config {
                    ring: self.ring_lane,
                    max_len: interface.max_len,
                    ..Config::new(&interface.contract, link, version, reliable, sealed)
                };
                let entry = self.counting.allocate(id, Some(link));
                let quota = self.mappings.peer(link.epoch, peer.node);
                let socket = (socket, self.link_room.hold());
                let driver = LinkDriver::new(token, Arc::new(peer), socket, config, entry, quota);
                self.last_token = token;
                self.routes.insert(token, id);
                self.with_interface(id, sets, |interface, context| {
                    interface.add_link(driver, context);
                });
                self.state_links();
            }
            Err(error) => {
                tracing::warn!(%link, peer = %peer.name, %error, "cannot use the link's socket");
                let code = Farewell::Resources.code();
                self.session.unlinked(id, link, code);
            }
        }
        self.sleepers.wake(EventSource::Interface(id));
    }
}
