//! The task of the hub.

use std::{collections::BTreeMap, sync::Arc};

use sm2_proto::{Name, gateway::GatewayId};
use tokio::sync::mpsc;

use super::{
    Asked, Message, NetworkMessage,
    connection::{Senders, Shared, lock},
    goodbye, local, shadow, status,
};
use crate::{
    hub::{Hub, Input, LocalCommand, LocalEvent, NoRoom, Output},
    peer::{Command, Event},
    question::Question,
    shadow::RuleSet,
};

/// The hub, and the ways to all others.
struct Task {
    hub: Hub,
    /// What the configuration calls peers.
    names: BTreeMap<GatewayId, Name>,
    /// The line of each rule.
    lines: Vec<usize>,
    /// How often what is there has changed, or the rules.
    revision: u64,
    shared: Arc<Shared>,
    local: local::Orders,
    connections: BTreeMap<u64, Connection>,
}

struct Connection {
    is_dialled: bool,
    senders: Senders,
}

/// What the configuration says that the hub itself need not know.
#[derive(Debug)]
pub(crate) struct Known {
    /// What it calls peers.
    pub(super) names: BTreeMap<GatewayId, Name>,
    /// The line of each rule.
    pub(super) lines: Vec<usize>,
}

pub(super) async fn run(
    hub: Hub,
    Known { names, lines }: Known,
    shared: Arc<Shared>,
    mut inbox: mpsc::Receiver<Message>,
    local: local::Orders,
) {
    let mut task = Task {
        hub,
        names,
        lines,
        revision: 1,
        shared,
        local,
        connections: BTreeMap::new(),
    };
    while let Some(message) = inbox.recv().await {
        task.message(message);
    }
}

impl Task {
    fn message(&mut self, message: Message) {
        match message {
            Message::Opened {
                connection,
                is_dialled,
                senders,
            } => {
                let it = Connection {
                    is_dialled,
                    senders,
                };
                self.connections.insert(connection, it);
            }
            Message::Peer { connection, event } => self.event(connection, event),
            Message::Local(event) => {
                self.revision += u64::from(matches!(event, LocalEvent::Present { .. }));
                self.handle(Input::Local(event));
            }
            Message::Reload {
                policy,
                known: Known { names, lines },
            } => {
                let gone: Vec<GatewayId> = (self.names.keys())
                    .filter(|it| !names.contains_key(it))
                    .copied()
                    .collect();
                (self.names, self.lines) = (names, lines);
                self.revision += 1;
                for peer in gone {
                    self.handle(Input::Distrust(peer));
                }
                self.handle(Input::Policy(policy));
            }
            Message::Report(answer) => {
                let asked = (self.hub.peers().into_iter()).map(|peer| {
                    let connection = self.connections.get(&peer.connection);
                    let answer = connection.map(|it| it.senders.ask());
                    (peer, answer)
                });
                let draft = status::Draft {
                    me: self.shared.me.clone(),
                    names: self.names.clone(),
                    lines: self.lines.clone(),
                    shadow: lock(&self.shared.shadow).clone(),
                    peers: asked.collect(),
                };
                // The hub waits for no connection.
                tokio::spawn(draft.complete(answer));
            }
            Message::Ask { question, answer } => {
                // Whoever asked may have gone.
                let _ = answer.send(self.ask_peer(question));
            }
            Message::View { known, answer } => {
                let view = (known != self.revision).then(|| shadow::View {
                    revision: self.revision,
                    rules: RuleSet {
                        rules: self.hub.rules().clone(),
                        peers: self.names.keys().copied().collect(),
                    },
                    names: self.names.clone(),
                    seen: self.hub.seen(),
                });
                // Whoever asked may have gone.
                let _ = answer.send(view);
            }
            Message::Stop => {
                for it in self.connections.values() {
                    it.senders.command(Command::Close(goodbye()));
                }
            }
        }
    }

    fn event(&mut self, connection: u64, mut event: Event) {
        let Some(it) = self.connections.get(&connection) else {
            return;
        };
        let is_dialled = it.is_dialled;
        // Whatever a peer calls itself: two of them may say the same.
        if let Event::Greeted { peer, name, .. } = &mut event {
            match self.names.get(peer) {
                Some(known) => *name = known.clone(),
                // Not trusted any more since the handshake.
                None => {
                    it.senders.command(Command::Close(goodbye()));
                    return;
                }
            }
        }
        let is_over = matches!(event, Event::Ended(_));
        let is_offer = matches!(event, Event::Offered { .. } | Event::Gone { .. });
        self.revision += u64::from(is_over || is_offer);
        self.handle(Input::Peer {
            connection,
            is_dialled,
            event,
        });
        if is_over {
            self.connections.remove(&connection);
        }
    }

    fn handle(&mut self, input: Input) {
        self.hub.handle(sm2_io::clock::now(), input);
        while let Some(output) = self.hub.poll() {
            match output {
                Output::Peer {
                    connection,
                    command,
                } => {
                    let it = self.connections.get(&connection);
                    let back = it.and_then(|it| it.senders.command(command));
                    if let Some(Command::Message { offer, .. }) = back {
                        self.no_room(NoRoom::ForPeer { connection, offer });
                    }
                }
                Output::Local(command) => {
                    let back = self.local.send(command);
                    if let Some(LocalCommand::Publish {
                        subject, origin, ..
                    }) = back
                    {
                        self.no_room(NoRoom::ForDomain { subject, origin });
                    }
                }
                Output::Connected { peer, epoch, name } => {
                    tracing::info!(%name, id = %peer, "connected");
                    lock(&self.shared.epochs).insert(peer, epoch);
                    self.network(NetworkMessage::Connected { peer, epoch });
                }
                Output::Lost { peer } => {
                    tracing::info!(name = self.names.get(&peer).map(Name::as_str), id = %peer, "lost");
                    self.network(NetworkMessage::Lost { peer });
                }
            }
        }
    }

    fn ask_peer(&self, question: Question) -> Asked {
        let Question { peer, kind, name } = question;
        let is_it = |(id, name): &(&GatewayId, &Name)| {
            name.as_str() == peer.as_str() || id.to_string() == peer
        };
        let Some((id, _)) = self.names.iter().find(is_it) else {
            return Asked::NoSuchPeer;
        };
        let connection = self.hub.connection(id);
        match connection.and_then(|it| self.connections.get(&it)) {
            Some(it) => Asked::Peer(it.senders.ask_peer(kind, name)),
            None => Asked::NotConnected,
        }
    }

    fn no_room(&mut self, what: NoRoom) {
        let now = sm2_io::clock::now();
        self.hub.handle(now, Input::NoRoom(what));
    }

    /// Without a network there is nothing to be told.
    fn network(&self, message: NetworkMessage) {
        let _ = self.shared.network.send(message);
    }
}
