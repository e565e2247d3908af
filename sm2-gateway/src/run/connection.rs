//! The task of one connection.

use std::{collections::BTreeMap, net::SocketAddr, sync::Arc, time::Duration};

use quinn_proto::{Connection, ConnectionHandle, EndpointEvent};
use sm2_io::quic::Socket;
use sm2_proto::{
    Instant, Machine,
    gateway::{
        AskId, GatewayId, Verdict,
        session::{self, ControlCommand},
    },
};
use tokio::sync::oneshot;

use super::{
    gateway_state::{GatewayState, lock},
    timer::sleep_until,
};
use crate::{
    channel::{
        connection::{ConnectionReport, PeerInbox, PeerQuery},
        hub::HubEvent,
        network::NetworkEvent,
    },
    peer::{Command, ConnectionId, Event, Input, Output, Peer, Reason},
};

/// Upper bound of datagrams per iteration, so that the other queues are served in between.
const BURST: usize = 64;
/// How long an ended connection still answers datagrams.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(3);

/// The state of a connection task.
pub(super) struct Task {
    shared: Arc<GatewayState>,
    handle: ConnectionHandle,
    /// The connection's number, which is not used again.
    number: ConnectionId,
    /// The peer that this side dialled; `None` if the other side dialled.
    dialled_peer: Option<GatewayId>,
    peer: Peer,
    /// The socket that sends the datagrams of this peer alone, once the peer has greeted.
    sender: Option<Socket>,
    /// The pending questions to the peer.
    pending_asks: BTreeMap<AskId, oneshot::Sender<Verdict>>,
    last_ask: AskId,
    ended_at: Option<Instant>,
}

impl Task {
    pub(super) fn new(
        shared: Arc<GatewayState>,
        handle: ConnectionHandle,
        number: ConnectionId,
        dialled_peer: Option<GatewayId>,
        connection: Connection,
    ) -> Self {
        let epochs = lock(&shared.epochs).clone();
        let peer = Peer::new(
            connection,
            shared.clock,
            shared.me.clone(),
            epochs,
            shared.limits,
        )
        .with_budget(shared.budget.clone());
        Self {
            shared,
            handle,
            number,
            dialled_peer,
            peer,
            sender: None,
            pending_asks: BTreeMap::new(),
            last_ask: AskId(0),
            ended_at: None,
        }
    }

    pub(super) async fn run(mut self, mut inbox: PeerInbox) {
        let mut buffer = Vec::new();
        loop {
            let has_more = self.transmit(&mut buffer).await;
            if self.peer.is_drained() || self.has_drained() {
                break;
            }
            let drained = self.ended_at.map(|it| it.after(DRAIN_TIMEOUT));
            let immediately = has_more.then(sm2_io::clock::now);
            let deadlines = [self.peer.deadline(), drained, immediately];
            let wait = sleep_until(deadlines.into_iter().flatten().min());
            tokio::select! {
                biased;
                Some(event) = inbox.endpoint.recv() => self.handle(Input::Quic(event)).await,
                Some(event) = inbox.datagrams.recv() => {
                    self.handle(Input::Quic(event)).await;
                    for _ in 0..BURST {
                        let Ok(event) = inbox.datagrams.try_recv() else { break };
                        self.handle(Input::Quic(event)).await;
                    }
                }
                command = inbox.commands.recv() => match command {
                    Some(command) => self.handle(Input::Command(command)).await,
                    None => break,
                },
                Some(query) = inbox.queries.recv() => self.query(query).await,
                Some(message) = inbox.messages.recv() => self.handle(Input::Command(message)).await,
                () = wait => self.handle(Input::Tick).await,
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

    /// Feeds the connection, and carries out its outputs.
    async fn handle(&mut self, input: Input) {
        let Ok(()) = self.peer.handle(sm2_io::clock::now(), input);
        while let Some(output) = self.peer.poll() {
            match output {
                Output::Event(event) => self.event(event).await,
                Output::Endpoint(event) => self.tell_endpoint(event),
            }
        }
    }

    async fn query(&mut self, query: PeerQuery) {
        match query {
            PeerQuery::Report(answer) => {
                // The asker may have timed out.
                let _ = answer.send(self.report());
            }
            PeerQuery::AskPeer { kind, name, answer } => {
                self.last_ask.0 += 1;
                let ask = self.last_ask;
                self.pending_asks.insert(ask, answer);
                let command = Command::Control(ControlCommand::Ask { ask, kind, name });
                self.handle(Input::Command(command)).await;
            }
        }
    }

    /// Sends with a socket of its own from now on. A link that takes no datagrams fills the buffer of its socket, and
    /// must not hold up other peers.
    fn use_own_socket(&mut self) {
        match self.shared.socket.sender() {
            Ok(socket) => self.sender = Some(socket),
            Err(error) => {
                let address = self.peer.address();
                tracing::warn!(%address, %error, "no socket for this peer alone: if its link is stuck, others wait");
            }
        }
    }

    fn ended(&mut self, reason: &Reason) {
        // Dropping the senders tells the askers that no answer comes.
        self.pending_asks.clear();
        tracing::info!(address = %self.peer.address(), "{reason}");
        self.ended_at = Some(sm2_io::clock::now());
        if let Some(peer) = self.dialled_peer {
            let is_stale = reason.is_stale();
            let failed = NetworkEvent::Failed { peer, is_stale };
            self.shared.network.send(failed);
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

    /// Handles an event here, or passes it on to the hub.
    async fn event(&mut self, event: Event) {
        match &event {
            Event::Session(session::Event::Answered { ask, verdict }) => {
                return self.answered(*ask, *verdict);
            }
            Event::NotAsked { ask } => {
                // The task that asked sees its channel closed.
                self.pending_asks.remove(ask);
                return;
            }
            Event::Ended(reason) => self.ended(reason),
            Event::Session(session::Event::Greeted { .. }) => self.use_own_socket(),
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
        // Fails only if the hub has stopped, and then nobody needs the event.
        let _ = self.shared.hub.send(event).await;
    }

    /// Sends datagrams. True if more datagrams may be ready to send.
    async fn transmit(&mut self, buffer: &mut Vec<u8>) -> bool {
        let socket = self.sender.as_ref().unwrap_or(&self.shared.socket);
        let segments = socket.max_segments();
        for _ in 0..BURST {
            buffer.clear();
            let now = sm2_io::clock::now();
            let Some(transmit) = self.peer.poll_transmit(now, segments, buffer) else {
                return false;
            };
            match socket.send(&transmit, buffer).await {
                Ok(None) => {}
                Ok(Some(error)) => {
                    let (address, len_bytes) = (self.peer.address(), transmit.size);
                    tracing::debug!(%address, len_bytes, %error, "the kernel refuses datagrams");
                }
                Err(_) => return false,
            }
        }
        true
    }

    fn report(&self) -> ConnectionReport {
        let counts = self.peer.counts_by_name();
        let (address, since) = (self.peer.address(), self.peer.established_at());
        ConnectionReport {
            counts: self.peer.counts(),
            counts_by_name: counts.map(|(key, it)| (key.clone(), it)).collect(),
            rtt: self.peer.rtt(),
            age: since.map(|it| sm2_io::clock::now().since(it)),
            address: SocketAddr::new(address.ip().to_canonical(), address.port()),
        }
    }
}
