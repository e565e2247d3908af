//! The network task: receives datagrams, dials peers, sends and receives beacons.

use std::{collections::BTreeMap, io, net::SocketAddr, sync::Arc};

use quinn_proto::{Connection, ConnectionHandle};
use sm2_io::{
    is_shortage,
    quic::{Arrival, Batch, Endpoint},
};
use sm2_proto::{
    Machine,
    gateway::{
        Beacon, GatewayId,
        discovery::{Discovery, Input, Output},
        session::Initiator,
    },
};
use tokio::sync::mpsc;

use super::{
    beacons::Beacons, connection::Task, gateway_state::GatewayState, hosts::Hosts,
    timer::sleep_until,
};
use crate::{
    Address,
    channel::{
        connection::{self, PeerHandle},
        hub::HubEvent,
        network::NetworkEvent,
    },
    config::PeerConfig,
    peer::ConnectionId,
    retry,
};

/// The state of the network task.
pub(super) struct Network {
    endpoint: Endpoint,
    beacons: Option<Beacons>,
    shared: Arc<GatewayState>,
    /// The address of the socket.
    local: SocketAddr,
    discovery: Discovery,
    peers: Vec<GatewayId>,
    /// The host names of peers.
    hosts: Hosts,
    connections: BTreeMap<ConnectionHandle, PeerHandle>,
    /// The number of the last connection.
    last: ConnectionId,
}

impl Network {
    pub(super) fn new(
        endpoint: Endpoint,
        beacons: Option<Beacons>,
        shared: Arc<GatewayState>,
        local: SocketAddr,
        hosts: Hosts,
    ) -> Self {
        let hop = shared.me.hop;
        let now = sm2_io::clock::now();
        let discovery = Discovery::new(now, hop.gateway, hop.epoch, beacons.is_some());
        Self {
            endpoint,
            beacons,
            shared,
            local,
            discovery,
            peers: Vec::new(),
            hosts,
            connections: BTreeMap::new(),
            last: ConnectionId::default(),
        }
    }

    pub(super) async fn run(
        mut self,
        peers: Vec<PeerConfig>,
        mut inbox: mpsc::UnboundedReceiver<NetworkEvent>,
    ) -> io::Result<()> {
        self.trust(peers).await;
        let shared = Arc::clone(&self.shared);
        let mut batch = Batch::new();
        let mut answer = Vec::new();
        let mut beacon = vec![0; 512];
        let mut pauses = retry::pauses();
        loop {
            self.drain_discovery().await;
            let wait = sleep_until(self.discovery.deadline());
            tokio::select! {
                received = shared.socket.recv(&mut batch) => match received {
                    Ok(()) => {
                        pauses = retry::pauses();
                        self.datagrams(&batch, &mut answer).await;
                    }
                    // The datagrams wait in the socket.
                    Err(error) if is_shortage(&error) => {
                        tracing::warn!(%error, "cannot receive datagrams; retries");
                        tokio::time::sleep(pauses.wait()).await;
                    }
                    Err(error) => return Err(error),
                },
                event = inbox.recv() => match event {
                    Some(event) => self.event(event).await,
                    None => return Ok(()),
                },
                (from, len) = Beacons::recv(self.beacons.as_ref(), &mut beacon) => {
                    let bytes = &beacon[..len];
                    self.feed(Input::Beacon { from, bytes });
                }
                () = wait => self.feed(Input::Tick),
            }
        }
    }

    async fn datagrams(&mut self, batch: &Batch, answer: &mut Vec<u8>) {
        let now = self.shared.clock.now().quic;
        for (from, ecn, datagram) in batch.datagrams() {
            answer.clear();
            match self.endpoint.handle(now, from, ecn, datagram, answer) {
                None => {}
                Some(Arrival::New(handle, connection)) => {
                    self.open(handle, None, *connection).await;
                }
                Some(Arrival::Event(handle, event)) => {
                    if let Some(task) = self.connections.get(&handle) {
                        task.datagram(event);
                    }
                }
                Some(Arrival::Answer(transmit)) => {
                    // A stranger must not make this task wait.
                    let _ = self.shared.socket.try_send(&transmit, answer);
                }
            }
        }
    }

    async fn event(&mut self, event: NetworkEvent) {
        match event {
            NetworkEvent::Endpoint { handle, event } => {
                if event.is_drained() {
                    self.connections.remove(&handle);
                }
                let answer = self.endpoint.event(handle, event);
                if let (Some(event), Some(task)) = (answer, self.connections.get(&handle)) {
                    task.endpoint_event(event);
                }
            }
            NetworkEvent::Failed { peer, is_stale } => {
                if is_stale {
                    self.feed(Input::Stale { peer });
                }
                self.feed(Input::Failed { peer });
            }
            NetworkEvent::Resolved {
                peer,
                host,
                addresses,
            } => match self.hosts.choose(peer, &host, addresses, self.local.ip()) {
                Some(address) => self.dial(peer, address).await,
                None => self.feed(Input::Failed { peer }),
            },
            NetworkEvent::Connected { peer, epoch } => self.feed(Input::Connected { peer, epoch }),
            NetworkEvent::Lost { peer } => self.feed(Input::Lost { peer }),
            NetworkEvent::Peers(peers) => self.trust(peers).await,
            NetworkEvent::Stop => {
                self.endpoint.close();
                self.trust(Vec::new()).await;
            }
        }
    }

    /// Feeds discovery. `drain_discovery` runs before the next input that requires it.
    fn feed(&mut self, input: Input<'_>) {
        let Ok(()) = self.discovery.handle(sm2_io::clock::now(), input);
    }

    async fn trust(&mut self, peers: Vec<PeerConfig>) {
        let ids: Vec<GatewayId> = peers.iter().map(|it| it.id).collect();
        for peer in std::mem::take(&mut self.peers) {
            if !ids.contains(&peer) {
                self.feed(Input::Distrust { peer });
                self.drain_discovery().await;
            }
        }
        self.peers = ids;
        self.hosts.forget();
        for PeerConfig { id, addresses, .. } in peers {
            let (peer, mut known) = (id, Vec::new());
            for address in addresses {
                match address {
                    Address::At(address) => known.push(address),
                    Address::Host(host) => self.hosts.add(peer, host),
                }
            }
            let addresses = known;
            let hosts = self.hosts.count(peer);
            self.feed(Input::Trust {
                peer,
                addresses,
                hosts,
            });
            self.drain_discovery().await;
        }
    }

    /// Executes the outputs of discovery.
    async fn drain_discovery(&mut self) {
        while let Some(output) = self.discovery.poll() {
            match output {
                Output::Dial { peer, address } => self.dial(peer, address).await,
                Output::DialHost { peer, host } => {
                    self.hosts.look_up(peer, host, self.shared.network.clone());
                }
                Output::Announce => {
                    let beacon = Beacon {
                        port: self.local.port(),
                        gateway: self.shared.me.hop.gateway,
                        epoch: self.shared.me.hop.epoch,
                    };
                    if let Some(beacons) = &self.beacons {
                        beacons.send(&beacon).await;
                    }
                }
            }
        }
    }

    async fn dial(&mut self, peer: GatewayId, address: SocketAddr) {
        let address = as_seen_from(self.local, address);
        let now = self.shared.clock.now().quic;
        match self.endpoint.connect(now, peer, address) {
            Ok((handle, connection)) => self.open(handle, Some(peer), connection).await,
            Err(error) => {
                tracing::warn!(%peer, %address, error, "cannot dial a peer");
                self.feed(Input::Failed { peer });
            }
        }
    }

    async fn open(
        &mut self,
        handle: ConnectionHandle,
        dialled_peer: Option<GatewayId>,
        connection: Connection,
    ) {
        self.last.0 += 1;
        let (task, inbox) = connection::channel();
        self.connections.insert(handle, task.clone());
        let event = HubEvent::Opened {
            connection: self.last,
            initiator: match dialled_peer {
                Some(_) => Initiator::ThisGateway,
                None => Initiator::Peer,
            },
            handle: task,
        };
        let _ = self.shared.hub.send(event).await;
        let shared = Arc::clone(&self.shared);
        let task = Task::new(shared, handle, self.last, dialled_peer, connection);
        tokio::spawn(task.run(inbox));
    }
}

/// How a socket at `local` reports `address` as a source. An IPv6 socket reports IPv4
/// sources as mapped addresses, and QUIC ignores answers from an address that it did not send to.
fn as_seen_from(local: SocketAddr, address: SocketAddr) -> SocketAddr {
    match (local, address) {
        (SocketAddr::V6(_), SocketAddr::V4(it)) => {
            SocketAddr::new(it.ip().to_ipv6_mapped().into(), it.port())
        }
        _ => address,
    }
}
