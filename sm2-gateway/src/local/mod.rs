//! The nodes of a gateway in its domain.
//!
//! The node `gateway/NAME` subscribes to topics that peers want, and calls servers for peers. For each
//! peer, a node `remote/PEER` has the publishers and servers that stand for those of the peer, so that
//! tools show where they come from. No gateway carries interfaces of these nodes to peers, which
//! excludes loops through a domain.

mod calls;
mod error;
mod requests;
#[cfg(test)]
mod tests;
mod topics;
mod watch;

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
};

use sm2_node::{
    Client, Node, Publisher,
    asynchronous::{AsyncClient, IntoAsync},
};
use sm2_proto::{
    Name,
    gateway::{GatewayId, Subject},
};
use tokio::task::AbortHandle;

pub use self::error::LocalError;
use self::{calls::Calls, requests::Requests, topics::Subscription, watch::RemoteTopics};
use crate::{
    channel::hub::HubHandle,
    domain::DomainLocation,
    hub::{LocalCommand, LocalEvent},
    names::{is_remote, own_node, remote_node},
};

/// A client of one service of the domain.
type RawClient = AsyncClient<[u8], [u8]>;

/// The nodes of a gateway.
#[derive(Debug)]
pub(crate) struct Local {
    location: DomainLocation,
    node: Node,
    hub: HubHandle,
    /// The greatest length of a message, a request or a reply of the domain.
    max_len_bytes: u64,
    /// The node of each peer that ever had an interface here. A node stays when its last interface
    /// goes: the Manager frees a name late, and the peer may return before that.
    remotes: BTreeMap<Name, Node>,
    topics: BTreeMap<Subject, Subscription>,
    clients: BTreeMap<Subject, Arc<RawClient>>,
    interfaces: BTreeMap<(Subject, GatewayId), RemoteInterface>,
    /// The interfaces that could not be declared.
    missing: Vec<Missing>,
    remote_topics: RemoteTopics,
    calls: Calls,
    requests: Arc<Mutex<Requests>>,
}

/// A publisher or server that stands for remote ones.
#[derive(Debug)]
enum RemoteInterface {
    Publisher(Box<Publisher<[u8]>>),
    /// The task that serves requests.
    Server(AbortHandle),
}

/// An interface that could not be declared.
#[derive(Debug, PartialEq, Eq)]
enum Missing {
    /// A subscription or a client.
    Subscription(Subject),
    /// A publisher or server that stands for remote ones of this peer.
    Proxy((Subject, GatewayId), Name),
}

impl Missing {
    const fn subject(&self) -> &Subject {
        match self {
            Self::Subscription(subject) | Self::Proxy((subject, _), _) => subject,
        }
    }

    fn is_proxy(&self, key: &(Subject, GatewayId)) -> bool {
        matches!(self, Self::Proxy(it, _) if it == key)
    }
}

fn unpublished((subject, origin): (Subject, GatewayId)) -> LocalEvent {
    LocalEvent::Unpublished { subject, origin }
}

impl Drop for RemoteInterface {
    fn drop(&mut self) {
        if let Self::Server(task) = self {
            task.abort();
        }
    }
}

impl Local {
    /// Joins the domain and starts to follow it. Events go to `hub`.
    ///
    /// # Errors
    /// See [`LocalError`].
    pub(crate) fn join(
        location: DomainLocation,
        gateway: &Name,
        max_len_bytes: u64,
        hub: HubHandle,
    ) -> Result<Self, LocalError> {
        let node = location.connect(own_node(gateway)?.as_str())?;
        let remote_topics = RemoteTopics::default();
        watch::start(&node, remote_topics.clone(), hub.clone())?;
        Ok(Self {
            location,
            node,
            hub,
            max_len_bytes,
            remotes: BTreeMap::new(),
            topics: BTreeMap::new(),
            clients: BTreeMap::new(),
            interfaces: BTreeMap::new(),
            missing: Vec::new(),
            remote_topics,
            calls: Calls::default(),
            requests: Arc::default(),
        })
    }

    /// The node `gateway/NAME`.
    #[must_use]
    pub(crate) const fn node(&self) -> &Node {
        &self.node
    }

    /// Executes a command of the hub, and returns the event of its failure, if the hub needs to know it. An
    /// interface that cannot be declared is logged, and declared by a later [`retry`](Self::retry).
    pub(crate) fn handle(&mut self, command: LocalCommand) -> Option<LocalEvent> {
        match command {
            LocalCommand::Subscribe { subject } => self.declare(Missing::Subscription(subject)),
            LocalCommand::Unsubscribe { subject } => {
                let ended = Missing::Subscription(subject.clone());
                self.missing.retain(|it| *it != ended);
                self.topics.remove(&subject);
                self.clients.remove(&subject);
            }
            LocalCommand::DeclareProxy {
                subject,
                origin,
                peer,
            } => self.declare(Missing::Proxy((subject, origin), peer)),
            LocalCommand::WithdrawProxy { subject, origin } => {
                self.withdraw_proxy(&(subject, origin))
            }
            LocalCommand::Publish {
                subject,
                origin,
                payload,
            } => return self.publish(subject, origin, &payload),
            LocalCommand::Call {
                call,
                subject,
                deadline,
                payload,
            } => {
                let client = self.clients.get(&subject).cloned();
                let server = calls::CalledServer {
                    client,
                    max_len_bytes: self.max_len_bytes,
                };
                self.calls
                    .start(call, server, deadline, payload, self.hub.clone());
            }
            LocalCommand::Cancel { call } => self.calls.cancel(call),
            LocalCommand::Reply {
                request,
                outcome,
                payload,
            } => requests::answer(&self.requests, request, outcome, payload),
        }
        None
    }

    fn publish(&self, subject: Subject, origin: GatewayId, payload: &[u8]) -> Option<LocalEvent> {
        let key = (subject, origin);
        let done = match self.interfaces.get(&key) {
            Some(RemoteInterface::Publisher(publisher)) => publisher.publish(payload).map(drop),
            Some(RemoteInterface::Server(_)) => Ok(()),
            None if !self.missing.iter().any(|it| it.is_proxy(&key)) => return None,
            None => return Some(unpublished(key)),
        };
        let error = done.err()?;
        tracing::warn!(%error, "cannot publish a remote message");
        Some(unpublished(key))
    }

    /// True if interfaces are missing that could not be declared.
    pub(crate) fn has_missing(&self) -> bool {
        !self.missing.is_empty()
    }

    /// Tries to declare the interfaces that are missing. Ends at the first one without an answer of a Manager: each of
    /// the others would wait as long.
    pub(crate) fn retry(&mut self) {
        let mut waiting = std::mem::take(&mut self.missing).into_iter();
        for missing in waiting.by_ref() {
            let Err(error) = self.try_declare(&missing) else {
                continue;
            };
            let name = missing.subject().name();
            tracing::debug!(%name, %error, "still cannot declare an interface of a gateway");
            self.missing.push(missing);
            if error.lacks_manager() {
                break;
            }
        }
        self.missing.extend(waiting);
    }

    fn declare(&mut self, missing: Missing) {
        if let Err(error) = self.try_declare(&missing) {
            let name = missing.subject().name();
            tracing::warn!(%name, %error, "cannot declare an interface of a gateway; retries");
            self.missing.push(missing);
        }
    }

    fn try_declare(&mut self, missing: &Missing) -> Result<(), LocalError> {
        match missing {
            Missing::Subscription(subject) => self.subscribe(subject),
            Missing::Proxy((subject, origin), peer) => self.declare_proxy(subject, *origin, peer),
        }
    }

    fn subscribe(&mut self, subject: &Subject) -> Result<(), LocalError> {
        // Another depth: the subscription does not depend on it (see `topics::DEPTH_IN`).
        if self.topics.contains_key(subject) || self.clients.contains_key(subject) {
            return Ok(());
        }
        match subject {
            Subject::Topic { name, data, .. } => {
                let max_len_bytes = self.max_len_bytes;
                let subscription =
                    topics::declare_subscriber(&self.node, name, data, max_len_bytes);
                subscription
                    .map(|it| topics::forward(it, subject.clone(), max_len_bytes, self.hub.clone()))
                    .map(|it| drop(self.topics.insert(subject.clone(), it)))
            }
            Subject::Service {
                name,
                request,
                reply,
            } => self.client(name, request, reply).map(|it| {
                self.clients.insert(subject.clone(), Arc::new(it));
            }),
        }
    }

    fn client(
        &self,
        name: &Name,
        request: &sm2_proto::TypeId,
        reply: &sm2_proto::TypeId,
    ) -> Result<RawClient, LocalError> {
        let client: Client<[u8], [u8]> = (self.node)
            .client_builder(name.as_str())
            .type_ids(request.clone(), reply.clone())
            .servers(|node| !is_remote(node))
            .max_borrowed(256)
            .max_len(self.max_len_bytes)
            .declare()?;
        Ok(client.into_async()?)
    }

    fn declare_proxy(
        &mut self,
        subject: &Subject,
        origin: GatewayId,
        peer: &Name,
    ) -> Result<(), LocalError> {
        let node = self.remote(peer)?;
        let interface = match subject {
            Subject::Topic {
                name,
                data,
                reliable,
                latched,
            } => {
                self.remote_topics.insert(subject, origin);
                let publisher = topics::publisher(&node, name, data, *reliable, *latched)?;
                RemoteInterface::Publisher(Box::new(publisher))
            }
            Subject::Service {
                name,
                request,
                reply,
            } => {
                let requests = Arc::clone(&self.requests);
                let types = [request, reply];
                let server = requests::server(&node, name, types, self.max_len_bytes)?;
                let task = requests::serve(
                    server,
                    requests::Forward {
                        subject: subject.clone(),
                        origin,
                        max_len_bytes: self.max_len_bytes,
                        requests,
                        hub: self.hub.clone(),
                    },
                );
                RemoteInterface::Server(tokio::spawn(task).abort_handle())
            }
        };
        self.interfaces.insert((subject.clone(), origin), interface);
        Ok(())
    }

    /// The node that stands for a peer.
    fn remote(&mut self, peer: &Name) -> Result<Node, LocalError> {
        if let Some(node) = self.remotes.get(peer) {
            return Ok(node.clone());
        }
        let name = remote_node(peer)?;
        let node = self.location.connect(name.as_str())?;
        self.remotes.insert(peer.clone(), node.clone());
        Ok(node)
    }

    fn withdraw_proxy(&mut self, key: &(Subject, GatewayId)) {
        self.missing.retain(|it| !it.is_proxy(key));
        self.remote_topics.remove(key);
        self.interfaces.remove(key);
    }
}
