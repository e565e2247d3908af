//! One turn of a connection, as its task has it in `run`.

use std::collections::BTreeMap;

use quinn_proto::{ConnectionHandle, EndpointEvent};
use sm2_gateway::{
    hub::Input,
    peer::{Command, ConnectionId, Event, Peer},
};
use sm2_proto::{
    Instant,
    gateway::{GatewayId, Hop, OfferId, Subject, discovery},
};

use crate::{
    network::MS,
    node::{Message, Node, World},
    queue::Queue,
};

/// How long a connection that is over goes on answering.
pub(crate) const DRAIN: u64 = 3_000 * MS;
/// One connection, and what waits for it.
pub(crate) struct Link {
    pub(crate) number: ConnectionId,
    pub(crate) dialled: Option<GatewayId>,
    pub(crate) peer: Peer,
    pub(crate) commands: Queue<Command>,
    pub(crate) messages: Queue<Command>,
    /// What the hub offers on it.
    pub(crate) offers: BTreeMap<OfferId, (Subject, Vec<Hop>)>,
    pub(crate) ended: Option<Instant>,
}

impl Node {
    /// One turn of a connection; whether there was nothing to do.
    pub(crate) fn link(
        &mut self,
        now: Instant,
        handle: ConnectionHandle,
        world: &mut World,
    ) -> bool {
        let moment = world.clock.at(now);
        let mut is_quiet = true;
        let Some(link) = self.links.get_mut(&handle) else {
            return true;
        };
        if link.peer.deadline().is_some_and(|it| it <= now) {
            is_quiet = false;
            link.peer.handle_timeout(moment);
        }
        while let Some(command) = link.commands.pop(now).or_else(|| link.messages.pop(now)) {
            is_quiet = false;
            link.peer.command(moment, command);
        }
        let (mut events, mut said, mut sent) = (Vec::new(), Vec::new(), Vec::new());
        while let Some(event) = link.peer.poll() {
            if let Event::Ended(_) = &event {
                link.ended = Some(now);
            }
            let (connection, is_dialled) = (link.number, link.peer.is_dialled());
            events.push(Input::Peer {
                connection,
                is_dialled,
                event,
            });
        }
        while let Some(event) = link.peer.poll_endpoint() {
            said.push(event);
        }
        let mut buffer = Vec::new();
        while let Some(transmit) = link.peer.poll_transmit(moment, 4, &mut buffer) {
            sent.push((transmit, std::mem::take(&mut buffer)));
        }
        let is_over = link
            .ended
            .is_some_and(|at| now.0 >= at.0 + DRAIN || link.peer.is_drained());
        let dialled = link.dialled;
        for (transmit, bytes) in sent {
            self.send(now, &transmit, &bytes, world);
        }
        if is_over && !self.links[&handle].peer.is_drained() {
            said.push(EndpointEvent::drained());
        }
        for event in said {
            is_quiet = false;
            if let (Some(event), Some(link)) = (
                self.endpoint.event(handle, event),
                self.links.get_mut(&handle),
            ) {
                link.peer.handle_event(moment, event);
            }
        }
        if is_over {
            self.links.remove(&handle);
        }
        for event in events {
            is_quiet = false;
            if let (
                Input::Peer {
                    event: Event::Ended(reason),
                    ..
                },
                index,
            ) = (&event, self.index)
            {
                world.ledger.trace.add(now, index, &reason.to_string());
                if let Some(peer) = dialled {
                    self.discover(now, discovery::Input::Failed { peer }, world);
                }
            }
            self.tell(now, Message::Hub(event));
        }
        is_quiet
    }
}
