//! The hub task: drives the [`Hub`] and executes its outputs.

use std::{collections::BTreeMap, sync::Arc};

use sm2_proto::{
    Code, Machine, Name,
    gateway::{
        GatewayId, PeerFarewell, Subject,
        session::{self, Initiator},
    },
};
use tokio::sync::{
    mpsc::{self, error::TryRecvError},
    oneshot,
};

use super::{
    gateway_state::{GatewayState, lock},
    status,
};
use crate::{
    Report,
    availability::AvailabilityRequest,
    channel::{
        connection::PeerHandle,
        hub::{ConfigLabels, HubEvent, PeerLookup, PolicySnapshot},
        local::LocalHandle,
        network::NetworkEvent,
    },
    hub::{Hub, Input, LocalCommand, LocalEvent, NoRoom, Output},
    peer::{Command, ConnectionId, Event},
    report::subject_label,
    shadow::RuleSet,
};

/// The code that closes a connection when this gateway stops, or stops trusting the peer.
const SHUTTING_DOWN: Code = PeerFarewell::ShuttingDown.code();

/// So many topics and services without room are logged one by one.
const LOGGED_MAX: u64 = 16;

/// The state of the hub task.
struct Task {
    hub: Hub,
    /// The name of each trusted peer.
    names: BTreeMap<GatewayId, Name>,
    /// The line of each rule.
    rule_lines: Vec<usize>,
    /// Counts changes of rules and subjects.
    revision: u64,
    shared: Arc<GatewayState>,
    local: LocalHandle,
    connections: BTreeMap<ConnectionId, Connection>,
    /// How often there was no room for a topic or service.
    waited: u64,
}

struct Connection {
    initiator: Initiator,
    handle: PeerHandle,
}

pub(super) async fn run(
    hub: Hub,
    ConfigLabels { peers, rule_lines }: ConfigLabels,
    shared: Arc<GatewayState>,
    mut inbox: mpsc::Receiver<HubEvent>,
    local: LocalHandle,
) {
    let mut task = Task {
        hub,
        names: peers,
        rule_lines,
        revision: 1,
        shared,
        local,
        connections: BTreeMap::new(),
        waited: 0,
    };
    loop {
        let event = match task.hub.deadline() {
            None => inbox.recv().await,
            // Pieces and events take turns, so that neither waits for more than one of the other.
            Some(_) => {
                task.handle(Input::Tick);
                tokio::task::yield_now().await;
                match inbox.try_recv() {
                    Err(TryRecvError::Empty) => continue,
                    event => event.ok(),
                }
            }
        };
        let Some(event) = event else { return };
        task.hub_event(event);
    }
}

impl Task {
    fn hub_event(&mut self, event: HubEvent) {
        match event {
            HubEvent::Opened {
                connection,
                initiator,
                handle,
            } => {
                let it = Connection { initiator, handle };
                self.connections.insert(connection, it);
            }
            HubEvent::Peer { connection, event } => self.event(connection, event),
            HubEvent::Local(event) => {
                self.revision += u64::from(matches!(event, LocalEvent::Present { .. }));
                self.handle(Input::Local(event));
            }
            HubEvent::Reload {
                policy,
                labels: ConfigLabels { peers, rule_lines },
            } => {
                let gone: Vec<GatewayId> = (self.names.keys())
                    .filter(|it| !peers.contains_key(it))
                    .copied()
                    .collect();
                (self.names, self.rule_lines) = (peers, rule_lines);
                self.revision += 1;
                for peer in gone {
                    self.handle(Input::Distrust(peer));
                }
                self.handle(Input::Policy(policy));
            }
            HubEvent::Report(answer) => self.report(answer),
            HubEvent::AskPeer { request, answer } => {
                // The asker may have timed out.
                let _ = answer.send(self.ask_peer(request));
            }
            HubEvent::Snapshot { known, answer } => {
                let snapshot = (known != self.revision).then(|| PolicySnapshot {
                    revision: self.revision,
                    rules: RuleSet {
                        rules: self.hub.rules().clone(),
                        peers: self.names.keys().copied().collect(),
                    },
                    names: self.names.clone(),
                    seen: self.hub.seen(),
                });
                // The asker may have timed out.
                let _ = answer.send(snapshot);
            }
            HubEvent::Stop => {
                for it in self.connections.values() {
                    it.handle.command(Command::Close(SHUTTING_DOWN));
                }
            }
        }
    }

    /// Answers with the status of the gateway.
    fn report(&self, answer: oneshot::Sender<Report>) {
        let asked = (self.hub.peers().into_iter()).map(|peer| {
            let connection = self.connections.get(&peer.connection);
            let answer = connection.map(|it| it.handle.report());
            (peer, answer)
        });
        let pending = status::PendingReport {
            me: self.shared.me.clone(),
            names: self.names.clone(),
            rule_lines: self.rule_lines.clone(),
            limits: self.shared.limits,
            waiting: self.hub.waiting().map(subject_label).collect(),
            shadow: lock(&self.shared.shadow).clone(),
            peers: asked.collect(),
        };
        // A task of its own, so that the hub does not wait for connections.
        tokio::spawn(pending.complete(answer));
    }

    fn event(&mut self, connection: ConnectionId, mut event: Event) {
        let Some(it) = self.connections.get(&connection) else {
            return;
        };
        let initiator = it.initiator;
        // Replaces the name that the peer gave itself, which need not be unique.
        if let Event::Session(session::Event::Greeted { peer, name, .. }) = &mut event {
            match self.names.get(peer) {
                Some(known) => *name = known.clone(),
                // A reload has removed the peer since the handshake.
                None => {
                    it.handle.command(Command::Close(SHUTTING_DOWN));
                    return;
                }
            }
        }
        let is_over = matches!(event, Event::Ended(_));
        let is_offer = matches!(
            event,
            Event::Session(session::Event::Offered { .. } | session::Event::Gone { .. })
        );
        self.revision += u64::from(is_over || is_offer);
        self.handle(Input::Peer {
            connection,
            initiator,
            event,
        });
        if is_over {
            self.connections.remove(&connection);
        }
    }

    fn handle(&mut self, input: Input) {
        let Ok(()) = self.hub.handle(sm2_io::clock::now(), input);
        while let Some(output) = self.hub.poll() {
            match output {
                Output::Peer {
                    connection,
                    command,
                } => {
                    let it = self.connections.get(&connection);
                    let rejected = it.and_then(|it| it.handle.command(command));
                    if let Some(Command::Message { offer, .. }) = rejected {
                        self.no_room(NoRoom::ForPeer { connection, offer });
                    }
                }
                Output::Local(command) => {
                    let rejected = self.local.send(command);
                    if let Some(LocalCommand::Publish {
                        subject, origin, ..
                    }) = rejected
                    {
                        self.no_room(NoRoom::ForDomain { subject, origin });
                    }
                }
                Output::Waits { subject } => self.waits(&subject),
                Output::Connected { peer, epoch, name } => {
                    tracing::info!(%name, id = %peer, "peer connected");
                    lock(&self.shared.epochs).insert(peer, epoch);
                    self.shared
                        .network
                        .send(NetworkEvent::Connected { peer, epoch });
                }
                Output::Lost { peer } => {
                    tracing::info!(name = self.names.get(&peer).map(Name::as_str), id = %peer, "peer disconnected");
                    //= SM2-GWC-005
                    lock(&self.shared.epochs).remove(&peer);
                    self.shared.network.send(NetworkEvent::Lost { peer });
                }
            }
        }
    }

    /// Logs that there is no room for a topic or service. One process can cause that for thousands.
    fn waits(&mut self, subject: &Subject) {
        self.waited += 1;
        let (name, count) = (subject.name(), self.waited);
        if count <= LOGGED_MAX {
            tracing::warn!(%name, "no descriptors for what a peer wants: raise the limit (ulimit -n)");
        } else if count.is_power_of_two() {
            tracing::warn!(
                "no descriptors for topics and services that peers want: {count} times so far"
            );
        }
    }

    fn ask_peer(&self, request: AvailabilityRequest) -> PeerLookup {
        let AvailabilityRequest { peer, kind, name } = request;
        let is_it = |(id, name): &(&GatewayId, &Name)| {
            name.as_str() == peer.as_str() || id.to_string() == peer
        };
        let Some((id, _)) = self.names.iter().find(is_it) else {
            return PeerLookup::Unknown;
        };
        let connection = self.hub.connection(id);
        match connection.and_then(|it| self.connections.get(&it)) {
            Some(it) => PeerLookup::Asked(it.handle.ask_peer(kind, name)),
            None => PeerLookup::NotConnected,
        }
    }

    fn no_room(&mut self, what: NoRoom) {
        let now = sm2_io::clock::now();
        let Ok(()) = self.hub.handle(now, Input::NoRoom(what));
    }
}
