//! The domain's side of a gateway: ordinary nodes.
//!
//! One node, `gateway/NAME`, subscribes to what peers want and calls the domain's servers; for each
//! peer there is a node `remote/PEER` whose publishers and servers stand for those behind it,
//! so that everybody in the domain sees where they come from. What such nodes have is never
//! taken for the domain's own, by no gateway: nothing goes round in circles.

mod calls;
mod requests;
mod topics;
mod watch;

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
};

use sm2_node::{
    Client, ConnectError, DeclareError, Node, Publisher,
    asynchronous::{AsyncClient, IntoAsync},
};
use sm2_proto::{
    Name, NameError,
    gateway::{GatewayId, Subject},
};
use tokio::task::AbortHandle;

use self::{calls::Calls, requests::Requests, topics::Subscription, watch::Shown};
use crate::{
    channel::hub::HubHandle,
    domain::DomainLocation,
    hub::LocalCommand,
    names::{is_remote, own_node, remote_node},
};

/// A client of the domain's servers of one service.
type RawClient = AsyncClient<[u8], [u8]>;

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

/// A gateway's nodes.
#[derive(Debug)]
pub(crate) struct Local {
    location: DomainLocation,
    node: Node,
    hub: HubHandle,
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
    /// Joins the domain, and follows it from now on. Events go to `hub`.
    ///
    /// # Errors
    /// See [`LocalError`].
    pub(crate) fn join(
        location: DomainLocation,
        gateway: &Name,
        hub: HubHandle,
    ) -> Result<Self, LocalError> {
        let node = location.connect(own_node(gateway)?.as_str())?;
        let shown_topics = Shown::default();
        watch::start(&node, shown_topics.clone(), hub.clone())?;
        Ok(Self {
            location,
            node,
            hub,
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
                    .start(call, client, deadline, payload, self.hub.clone());
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
                topics::subscribe(&self.node, &subject, name, data, self.hub.clone())
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
                let hub = self.hub.clone();
                let serving = tokio::spawn(requests::serve(
                    server,
                    subject.clone(),
                    origin,
                    requests,
                    hub,
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
            .location
            .connect(name.as_str())
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
