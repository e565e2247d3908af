//! The task of one connection.

use std::{collections::BTreeMap, net::SocketAddr, sync::Arc, time::Duration};

use quinn_proto::{Connection, ConnectionEvent, ConnectionHandle, EndpointEvent};
use sm2_proto::{
    Instant,
    gateway::{AskId, GatewayId, Verdict, session},
};
use tokio::sync::oneshot;

use super::{
    shared::{Shared, lock},
    timer::sleep_until,
};
use crate::{
    channel::{
        connection::{ConnectionReport, PeerInbox, PeerQuery},
        hub::HubEvent,
        network::NetworkEvent,
    },
    peer::{Command, ConnectionId, Event, Peer, Reason},
};

/// Upper bound of datagrams per iteration, so that the other queues are served in between.
const BURST: usize = 64;
/// How long an ended connection still answers datagrams.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(3);

/// The state of a connection task.
pub(super) struct Task {
    shared: Arc<Shared>,
    handle: ConnectionHandle,
    /// The connection's number, which is not used again.
    number: ConnectionId,
    dialled: Option<GatewayId>,
    peer: Peer,
    /// The pending questions to the peer.
    pending_asks: BTreeMap<AskId, oneshot::Sender<Verdict>>,
    last_ask: AskId,
    ended_at: Option<Instant>,
}

impl Task {
    pub(super) fn new(
        shared: Arc<Shared>,
        handle: ConnectionHandle,
        number: ConnectionId,
        dialled: Option<GatewayId>,
        connection: Connection,
    ) -> Self {
        let epochs = lock(&shared.epochs).clone();
        let peer = Peer::new(
            connection,
            shared.clock,
            shared.me.clone(),
            epochs,
            shared.limits,
        );
        Self {
            shared,
            handle,
            number,
            dialled,
            peer,
            pending_asks: BTreeMap::new(),
            last_ask: AskId(0),
            ended_at: None,
        }
    }

    pub(super) async fn run(mut self, mut inbox: PeerInbox) {
        let mut buffer = Vec::new();
        loop {
            let has_more = self.drain(&mut buffer).await;
            if self.peer.is_drained() || self.has_drained() {
                break;
            }
            let drained = self.ended_at.map(|it| it.after(DRAIN_TIMEOUT));
            let immediately = has_more.then(sm2_io::clock::now);
            let deadlines = [self.peer.deadline(), drained, immediately];
            let wait = sleep_until(deadlines.into_iter().flatten().min());
            tokio::select! {
                biased;
                Some(event) = inbox.endpoint.recv() => self.event(event),
                Some(event) = inbox.datagrams.recv() => {
                    self.event(event);
                    for _ in 0..BURST {
                        let Ok(event) = inbox.datagrams.try_recv() else { break };
                        self.event(event);
                    }
                }
                command = inbox.commands.recv() => match command {
                    Some(command) => self.command(command),
                    None => break,
                },
                Some(query) = inbox.queries.recv() => self.query(query),
                Some(message) = inbox.messages.recv() => self.command(message),
                () = wait => self.peer.handle_timeout(self.shared.clock.now()),
            }
        }
        if !self.peer.is_drained() {
            self.tell_endpoint(EndpointEvent::drained());
        }
    }

    fn has_drained(&self) -> bool {
        let ended = self.ended_at;
        ended.is_some_and(|it| sm2_io::clock::now().since(it) >= DRAIN_TIMEOUT)
    }

    fn event(&mut self, event: ConnectionEvent) {
        self.peer.handle_event(self.shared.clock.now(), event);
    }

    fn command(&mut self, command: Command) {
        self.peer.command(self.shared.clock.now(), command);
    }

    fn query(&mut self, query: PeerQuery) {
        match query {
            PeerQuery::Report(answer) => {
                // The asker may have timed out.
                let _ = answer.send(self.report());
            }
            PeerQuery::AskPeer { kind, name, answer } => {
                self.last_ask.0 += 1;
                let ask = self.last_ask;
                self.pending_asks.insert(ask, answer);
                self.command(Command::Ask { ask, kind, name });
            }
        }
    }

    fn ended(&mut self, reason: &Reason) {
        // Dropping the senders tells the askers that no answer comes.
        self.pending_asks.clear();
        tracing::info!(address = %self.peer.address(), "{reason}");
        self.ended_at = Some(sm2_io::clock::now());
        if let Some(peer) = self.dialled {
            self.shared.network.send(NetworkEvent::Failed { peer });
        }
    }

    fn answered(&mut self, ask: AskId, verdict: Verdict) {
        if let Some(answer) = self.pending_asks.remove(&ask) {
            // The asker may have timed out.
            let _ = answer.send(verdict);
        }
    }

    fn tell_endpoint(&self, event: EndpointEvent) {
        let handle = self.handle;
        let network = &self.shared.network;
        network.send(NetworkEvent::Endpoint { handle, event });
    }

    /// Drains the outputs of the connection. True if more datagrams may be ready to send.
    async fn drain(&mut self, buffer: &mut Vec<u8>) -> bool {
        while let Some(event) = self.peer.poll() {
            match &event {
                Event::Session(session::Event::Answered { ask, verdict }) => {
                    self.answered(*ask, *verdict);
                    continue;
                }
                Event::NotAsked { ask } => {
                    // The task that asked sees its channel closed.
                    self.pending_asks.remove(ask);
                    continue;
                }
                Event::Ended(reason) => self.ended(reason),
                Event::Session(_)
                | Event::Message { .. }
                | Event::Request { .. }
                | Event::Cancelled { .. }
                | Event::Reply { .. } => {}
            }
            let event = HubEvent::Peer {
                connection: self.number,
                event,
            };
            let _ = self.shared.hub.send(event).await;
        }
        while let Some(event) = self.peer.poll_endpoint() {
            self.tell_endpoint(event);
        }
        let segments = self.shared.socket.max_segments();
        let mut has_more = true;
        for _ in 0..BURST {
            buffer.clear();
            let now = self.shared.clock.now();
            let next = self.peer.poll_transmit(now, segments, buffer);
            has_more = next.is_some();
            let Some(transmit) = next else { break };
            if self.shared.socket.send(&transmit, buffer).await.is_err() {
                return false;
            }
        }
        has_more
    }

    fn report(&self) -> ConnectionReport {
        let counts = self.peer.counts_by_name();
        let address = self.peer.address();
        ConnectionReport {
            counts: self.peer.counts(),
            counts_by_name: counts.map(|(key, it)| (key.clone(), it)).collect(),
            rtt: self.peer.rtt(),
            address: SocketAddr::new(address.ip().to_canonical(), address.port()),
        }
    }
}
