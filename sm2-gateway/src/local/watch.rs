//! Follows the domain: its own publishers and servers, and its subscribers of remote topics.

use std::{
    collections::{BTreeMap, BTreeSet},
    io,
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::Duration,
};

use sm2_node::Node;
use sm2_proto::{
    Contract, Name, TypeId,
    domain::{Domain, InterfaceView},
    gateway::{GatewayId, Subject},
    limits::QOS_MAX,
};

use crate::{
    channel::hub::{HubEvent, HubHandle},
    hub::LocalEvent,
    names::is_of_gateway,
    retry,
};

/// Interval at which the thread checks that the hub still runs.
const STOP_CHECK_INTERVAL: Duration = Duration::from_secs(1);
/// Pause after a wait that returned without changes, which happens at once without a Manager.
const RETRY_DELAY: Duration = Duration::from_millis(100);

/// The remote topics that have a publisher in the domain.
#[derive(Clone, Debug, Default)]
pub(super) struct RemoteTopics(Arc<Mutex<Topics>>);

#[derive(Debug, Default)]
struct Topics {
    /// The generation of each topic: a topic that is removed and inserted again has another one.
    generations: BTreeMap<(Subject, GatewayId), u64>,
    last: u64,
}

impl RemoteTopics {
    pub(super) fn insert(&self, subject: &Subject, origin: GatewayId) {
        let mut topics = self.lock();
        topics.last += 1;
        let generation = topics.last;
        topics
            .generations
            .insert((subject.clone(), origin), generation);
    }

    pub(super) fn remove(&self, key: &(Subject, GatewayId)) {
        self.lock().generations.remove(key);
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Topics> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The part of the domain that concerns the gateway.
#[derive(Debug, Default, PartialEq, Eq)]
struct DomainState {
    /// The topics and services with publishers or servers of the domain itself.
    present: BTreeSet<Subject>,
    /// The greatest subscriber depth and the generation of each remote topic. The generation makes a
    /// re-inserted topic a difference, which the hub must learn.
    taken: BTreeMap<(Subject, GatewayId), (u16, u64)>,
}

/// Follows the domain on a thread of its own until the hub task ends.
pub(super) fn start(node: &Node, remote: RemoteTopics, hub: HubHandle) -> io::Result<()> {
    let mut watch = node.watch();
    let follow = move || {
        let mut state = DomainState::default();
        let mut pauses = retry::pauses();
        while !hub.is_closed() {
            match watch.wait_timeout(STOP_CHECK_INTERVAL) {
                Ok(changes) if changes.is_empty() => thread::sleep(RETRY_DELAY),
                Ok(_) => pauses = retry::pauses(),
                Err(error) => {
                    tracing::warn!(%error, "cannot follow the domain; retries");
                    thread::sleep(pauses.wait());
                    continue;
                }
            }
            let now = DomainState::of(watch.domain(), &remote.lock().generations);
            for event in state.difference(&now) {
                if hub.blocking_send(HubEvent::Local(event)).is_err() {
                    return;
                }
            }
            state = now;
        }
    };
    sm2_io::spawn_without_signals("watch".to_owned(), follow).map(drop)
}

impl DomainState {
    fn of(domain: &Domain, remote: &BTreeMap<(Subject, GatewayId), u64>) -> Self {
        let is_of_domain = |it: &InterfaceView<'_>| {
            let node = domain.node(it.entity.node);
            it.refused.is_none() && node.is_some_and(|node| !is_of_gateway(node.name))
        };
        let contracts: Vec<&Contract> = (domain.interfaces())
            .filter(is_of_domain)
            .map(|it| it.contract)
            .collect();
        let mut state = Self::default();
        let mut topics = BTreeMap::new();
        for contract in &contracts {
            match contract {
                Contract::Publisher { topic, data, offer } => {
                    let (reliable, latched) = topics.entry((topic, data)).or_insert((false, 0));
                    *reliable |= offer.reliable;
                    // Each publisher keeps its own latched messages.
                    *latched = QOS_MAX.min(*latched + offer.latched);
                }
                Contract::Server {
                    service,
                    request,
                    reply,
                    ..
                } => {
                    state.present.insert(Subject::Service {
                        name: service.clone(),
                        request: request.clone(),
                        reply: reply.clone(),
                    });
                }
                Contract::Subscriber { .. } | Contract::Client { .. } => {}
            }
        }
        let topics = topics.into_iter();
        let topic = |((name, data), (reliable, latched)): ((&Name, &TypeId), _)| Subject::Topic {
            name: name.clone(),
            data: data.clone(),
            reliable,
            latched,
        };
        state.present.extend(topics.map(topic));
        for ((subject, origin), generation) in remote {
            let takes = |contract: &&Contract| depth(contract, subject);
            if let Some(depth) = contracts.iter().filter_map(takes).max() {
                let taken = (depth, *generation);
                state.taken.insert((subject.clone(), *origin), taken);
            }
        }
        state
    }

    fn difference(&self, now: &Self) -> Vec<LocalEvent> {
        let present = |subject: &Subject, present| LocalEvent::Present {
            subject: subject.clone(),
            present,
        };
        let taken = |(subject, origin): &(Subject, GatewayId), taken| LocalEvent::Taken {
            subject: subject.clone(),
            origin: *origin,
            taken,
        };
        let gone = self.present.difference(&now.present);
        let new = now.present.difference(&self.present);
        let left = self.taken.keys().filter(|it| !now.taken.contains_key(it));
        let other = (now.taken.iter()).filter(|(it, taken)| self.taken.get(it) != Some(taken));
        (gone.map(|it| present(it, false)))
            .chain(new.map(|it| present(it, true)))
            .chain(left.map(|it| taken(it, None)))
            .chain(other.map(|(it, (depth, _))| taken(it, Some(*depth))))
            .collect()
    }
}

/// The depth of a subscriber that matches the topic.
fn depth(contract: &Contract, subject: &Subject) -> Option<u16> {
    match (contract, subject) {
        (
            Contract::Subscriber {
                topic,
                data,
                demand,
            },
            Subject::Topic {
                name, data: theirs, ..
            },
        ) if topic == name && data.as_ref().is_none_or(|it| it == theirs) => Some(demand.depth),
        _ => None,
    }
}
