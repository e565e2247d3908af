//! The domain's side of a gateway: ordinary nodes.
//!
//! One node, `gateway/NAME`, subscribes to what peers want and calls the domain's servers; for each
//! peer there is a node `remote/PEER` whose publishers and servers stand for those behind it,
//! so that everybody in the domain sees where they come from. What such nodes have is never
//! taken for the domain's own, by no gateway: nothing goes round in circles.

mod calls;
mod names;
mod requests;
mod topics;
mod watch;

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{Arc, Mutex},
    time::Duration,
};

use sm2_node::{
    Client, ConnectError, DeclareError, Node, Publisher,
    asynchronous::{AsyncClient, IntoAsync},
};
use sm2_proto::{
    Name, NameError,
    gateway::{GatewayId, Subject},
};
use tokio::{sync::mpsc, task::AbortHandle};

pub use self::names::{is_remote, status_service};
use self::{
    calls::Calls, names::remote_node, requests::Requests, topics::Subscription, watch::Shown,
};
use crate::{
    hub::{LocalCommand, LocalEvent},
    run::Message,
};

/// A client of the domain's servers of one service.
type RawClient = AsyncClient<[u8], [u8]>;

/// How long the Manager may take to answer.
const PATIENCE: Duration = Duration::from_secs(2);

/// Which domain.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// Its name; none: as the environment says.
    pub domain: Option<String>,
    /// The path of its Manager's socket, instead of the name.
    pub socket: Option<PathBuf>,
}

/// Why there is no way into the domain.
#[derive(Debug, thiserror::Error)]
pub enum LocalError {
    /// No Manager, or it does not want this node.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The Manager does not want the gateway's status service.
    #[error(transparent)]
    Declare(#[from] DeclareError),
    /// The system has no more descriptors or threads.
    #[error("cannot watch the domain: {0}")]
    Io(#[from] std::io::Error),
    /// The gateway's name makes no name of a node.
    #[error("{0}")]
    Name(#[from] NameError),
}

impl Place {
    /// A node there.
    ///
    /// # Errors
    /// See [`ConnectError`].
    pub fn node(&self, name: &str) -> Result<Node, ConnectError> {
        let mut builder = Node::builder(name).manager_timeout(PATIENCE);
        if let Some(domain) = &self.domain {
            builder = builder.domain(domain);
        }
        if let Some(socket) = &self.socket {
            builder = builder.socket(socket);
        }
        builder.connect()
    }
}

/// Where events go.
#[derive(Clone, Debug)]
struct Events(mpsc::Sender<Message>);

impl Events {
    /// Whether there is still a hub. Waits as long as that has too much to do: then the
    /// newest messages are taken from the domain, not all of them.
    async fn send(&self, event: LocalEvent) -> bool {
        self.0.send(Message::Local(event)).await.is_ok()
    }
}

/// A gateway's nodes.
#[derive(Debug)]
pub(crate) struct Local {
    place: Place,
    node: Node,
    events: Events,
    /// One for each peer that something was ever shown of. It stays: its name is not free at once
    /// when it goes, and then nothing could be shown when the peer is back.
    remotes: BTreeMap<Name, Node>,
    topics: BTreeMap<Subject, Subscription>,
    clients: BTreeMap<Subject, Arc<RawClient>>,
    shown: BTreeMap<(Subject, GatewayId), Show>,
    shown_topics: Shown,
    calls: Calls,
    requests: Arc<Mutex<Requests>>,
}

/// What stands for something remote.
#[derive(Debug)]
enum Show {
    Topic(Box<Publisher<[u8]>>),
    Service(AbortHandle),
}

impl Drop for Show {
    fn drop(&mut self) {
        if let Self::Service(serving) = self {
            serving.abort();
        }
    }
}

impl Local {
    /// Joins the domain, and follows it from now on. What happens there goes to `events`.
    ///
    /// # Errors
    /// See [`LocalError`].
    pub(crate) fn join(
        place: Place,
        gateway: &Name,
        events: mpsc::Sender<Message>,
    ) -> Result<Self, LocalError> {
        let node = place.node(names::own_node(gateway)?.as_str())?;
        let events = Events(events);
        let shown_topics = Shown::default();
        watch::start(&node, shown_topics.clone(), events.0.clone())?;
        Ok(Self {
            place,
            node,
            events,
            remotes: BTreeMap::new(),
            topics: BTreeMap::new(),
            clients: BTreeMap::new(),
            shown: BTreeMap::new(),
            shown_topics,
            calls: Calls::default(),
            requests: Arc::default(),
        })
    }

    /// The node that is the gateway's own.
    #[must_use]
    pub(crate) const fn node(&self) -> &Node {
        &self.node
    }

    /// Does what the hub wants. What the Manager does not grant is logged: the gateway goes on
    /// with the rest.
    pub(crate) fn handle(&mut self, command: LocalCommand) {
        match command {
            LocalCommand::Subscribe { subject, .. } => self.subscribe(subject),
            LocalCommand::Unsubscribe { subject } => {
                self.topics.remove(&subject);
                self.clients.remove(&subject);
            }
            LocalCommand::Show {
                subject,
                origin,
                peer,
            } => self.show(subject, origin, peer),
            LocalCommand::Hide { subject, origin } => self.hide(&(subject, origin)),
            LocalCommand::Publish {
                subject,
                origin,
                payload,
            } => {
                if let Some(Show::Topic(publisher)) = self.shown.get(&(subject, origin))
                    && let Err(error) = publisher.publish(&payload)
                {
                    tracing::warn!(%error, "a remote message was not published");
                }
            }
            LocalCommand::Call {
                call,
                subject,
                deadline,
                payload,
            } => {
                let client = self.clients.get(&subject).cloned();
                self.calls
                    .start(call, client, deadline, payload, self.events.clone());
            }
            LocalCommand::Cancel { call } => self.calls.cancel(call),
            LocalCommand::Reply {
                request,
                outcome,
                payload,
            } => requests::answer(&self.requests, request, outcome, payload),
        }
    }

    fn subscribe(&mut self, subject: Subject) {
        // Peers want it otherwise than before: it is taken in the same way.
        if self.topics.contains_key(&subject) || self.clients.contains_key(&subject) {
            return;
        }
        let done = match &subject {
            Subject::Topic { name, data, .. } => {
                topics::subscribe(&self.node, &subject, name, data, self.events.clone())
                    .map(|it| drop(self.topics.insert(subject.clone(), it)))
            }
            Subject::Service {
                name,
                request,
                reply,
            } => self.client(name, request, reply).map(|it| {
                self.clients.insert(subject.clone(), Arc::new(it));
            }),
        };
        if let Err(error) = done {
            tracing::warn!(name = %subject.name(), error, "the domain's side is not there");
        }
    }

    fn client(
        &self,
        name: &Name,
        request: &sm2_proto::TypeId,
        reply: &sm2_proto::TypeId,
    ) -> Result<RawClient, String> {
        let client: Client<[u8], [u8]> = (self.node)
            .client_builder(name.as_str())
            .type_ids(request.clone(), reply.clone())
            .servers(|node| !is_remote(node))
            .max_borrowed(256)
            .declare()
            .map_err(|error| error.to_string())?;
        client.into_async().map_err(|error| error.to_string())
    }

    fn show(&mut self, subject: Subject, origin: GatewayId, peer: Name) {
        let done = self.remote(&peer).and_then(|node| match &subject {
            Subject::Topic {
                name,
                data,
                reliable,
                latched,
            } => {
                self.shown_topics.insert(&subject, origin);
                let publisher = topics::publisher(&node, name, data, *reliable, *latched);
                publisher.map(|it| Show::Topic(Box::new(it)))
            }
            Subject::Service {
                name,
                request,
                reply,
            } => {
                let requests = Arc::clone(&self.requests);
                let server = requests::server(&node, name, request, reply)?;
                let events = self.events.clone();
                let serving = tokio::spawn(requests::serve(
                    server,
                    subject.clone(),
                    origin,
                    requests,
                    events,
                ));
                Ok(Show::Service(serving.abort_handle()))
            }
        });
        match done {
            Ok(show) => drop(self.shown.insert((subject, origin), show)),
            Err(error) => {
                tracing::warn!(name = %subject.name(), %peer, error, "a remote interface is not shown");
            }
        }
    }

    /// The node that stands for a peer.
    fn remote(&mut self, peer: &Name) -> Result<Node, String> {
        if let Some(node) = self.remotes.get(peer) {
            return Ok(node.clone());
        }
        let name = remote_node(peer).map_err(|error| error.to_string())?;
        let node = self
            .place
            .node(name.as_str())
            .map_err(|error| error.to_string())?;
        tokio::spawn(sm2_node::asynchronous::drive(node.clone()));
        self.remotes.insert(peer.clone(), node.clone());
        Ok(node)
    }

    fn hide(&mut self, what: &(Subject, GatewayId)) {
        self.shown_topics.remove(what);
        self.shown.remove(what);
    }
}
