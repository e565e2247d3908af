//! One connection, driven as its task in `run` drives it.

use std::collections::BTreeMap;

use quinn_proto::{ConnectionHandle, EndpointEvent, Transmit};
use sm2_gateway::{
    Counts, hub,
    peer::{Command, ConnectionId, Event, Input, Output, Peer},
};
use sm2_proto::{
    Instant, Machine,
    gateway::{GatewayId, Hop, OfferId, Subject, discovery},
};

use super::{
    network::MS,
    node::{Message, Node, World},
    queue::Queue,
};

/// How long an ended connection still answers datagrams.
pub(crate) const DRAIN: u64 = 3_000 * MS;

/// One connection, and its queues.
pub(crate) struct Link {
    pub(crate) number: ConnectionId,
    dialled: Option<GatewayId>,
    pub(crate) peer: Peer,
    pub(crate) commands: Queue<Command>,
    pub(crate) messages: Queue<Command>,
    /// The offers of the hub on this connection.
    pub(crate) offers: BTreeMap<OfferId, (Subject, Vec<Hop>)>,
    pub(crate) ended: Option<Instant>,
    /// Outputs that were polled and are not carried out yet.
    events: Vec<Event>,
    endpoint_events: Vec<EndpointEvent>,
}

impl Link {
    pub(crate) fn new(number: ConnectionId, dialled: Option<GatewayId>, peer: Peer) -> Self {
        Self {
            number,
            dialled,
            peer,
            commands: Queue::new(),
            messages: Queue::new(),
            offers: BTreeMap::new(),
            ended: None,
            events: Vec::new(),
            endpoint_events: Vec::new(),
        }
    }

    /// Feeds the connection, and polls its outputs.
    pub(crate) fn feed(&mut self, now: Instant, input: Input) {
        let Ok(()) = self.peer.handle(now, input);
        while let Some(output) = self.peer.poll() {
            match output {
                Output::Event(event) => {
                    if let Event::Ended(_) = &event {
                        self.ended = Some(now);
                    }
                    self.events.push(event);
                }
                Output::Endpoint(event) => self.endpoint_events.push(event),
            }
        }
        self.check_counts();
    }

    /// Each message, request and reply that was offered ends once: in the total, and under its name.
    fn check_counts(&self) {
        let ended = |it: &Counts| it.sent + it.superseded + it.expired + it.withdrawn;
        let total = self.peer.counts();
        match self.ended {
            Some(_) => assert_eq!(ended(&total), total.offered, "{total:?}"),
            None => assert!(ended(&total) <= total.offered, "{total:?}"),
        }
        for ((_, name), it) in self.peer.counts_by_name() {
            assert!(ended(&it) <= it.offered, "{name}: {it:?}");
        }
    }

    /// Feeds a tick and commands that are due. True if there were none.
    fn feed_due(&mut self, now: Instant) -> bool {
        let mut is_quiet = true;
        if self.peer.deadline().is_some_and(|it| it <= now) {
            is_quiet = false;
            self.feed(now, Input::Tick);
        }
        while let Some(command) = self.commands.pop(now).or_else(|| self.messages.pop(now)) {
            is_quiet = false;
            self.feed(now, Input::Command(command));
        }
        is_quiet
    }

    fn transmit(&mut self, now: Instant) -> Vec<(Transmit, Vec<u8>)> {
        let (mut sent, mut buffer) = (Vec::new(), Vec::new());
        while let Some(transmit) = self.peer.poll_transmit(now, 4, &mut buffer) {
            sent.push((transmit, std::mem::take(&mut buffer)));
        }
        sent
    }

    /// True if the connection has ended, and no longer answers datagrams.
    fn is_over(&self, now: Instant) -> bool {
        self.ended
            .is_some_and(|at| now.0 >= at.0 + DRAIN || self.peer.is_drained())
    }
}

impl Node {
    /// Does what is due on a connection. True if there was nothing to do.
    pub(crate) fn link(
        &mut self,
        now: Instant,
        handle: ConnectionHandle,
        world: &mut World,
    ) -> bool {
        let Some(link) = self.links.get_mut(&handle) else {
            return true;
        };
        let mut is_quiet = link.feed_due(now);
        for (transmit, bytes) in link.transmit(now) {
            self.send(now, &transmit, &bytes, world);
        }
        is_quiet &= self.tell_endpoint(now, handle);
        let Some(link) = self.links.get_mut(&handle) else {
            return true;
        };
        let (connection, initiator) = (link.number, link.peer.initiator());
        let (events, dialled) = (std::mem::take(&mut link.events), link.dialled);
        if link.is_over(now) {
            if !link.peer.is_drained() {
                self.endpoint.event(handle, EndpointEvent::drained());
            }
            self.links.remove(&handle);
        }
        for event in events {
            is_quiet = false;
            if let Event::Ended(reason) = &event {
                let text = reason.to_string();
                world.ledger.trace.add(now, self.index, &text);
                if let Some(peer) = dialled {
                    if reason.is_stale() {
                        self.discover(now, discovery::Input::Stale { peer }, world);
                    }
                    self.discover(now, discovery::Input::Failed { peer }, world);
                }
            }
            let input = hub::Input::Peer {
                connection,
                initiator,
                event,
            };
            self.tell(now, Message::Hub(input));
        }
        is_quiet
    }

    /// Passes events of a connection on to the endpoint, and its answers back. True if there were
    /// none.
    fn tell_endpoint(&mut self, now: Instant, handle: ConnectionHandle) -> bool {
        let mut is_quiet = true;
        while let Some(link) = self.links.get_mut(&handle)
            && !link.endpoint_events.is_empty()
        {
            is_quiet = false;
            let event = link.endpoint_events.remove(0);
            if let Some(answer) = self.endpoint.event(handle, event) {
                link.feed(now, Input::Quic(answer));
            }
        }
        is_quiet
    }
}
