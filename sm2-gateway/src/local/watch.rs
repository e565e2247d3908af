//! Follows the domain: its own publishers and servers, and its subscribers of remote topics.

use std::{
    collections::BTreeMap,
    io,
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::Duration,
};

use sm2_node::Node;
use sm2_proto::{
    Contract, Name, TypeId,
    control::Limit,
    domain::{Domain, InterfaceView, NodeView},
    gateway::{GatewayId, Subject},
    limits::QOS_MAX,
};

use crate::{
    channel::hub::{HubEvent, HubHandle},
    hub::{Links, LocalEvent, Process},
    names::is_of_gateway,
    retry,
};

/// How often the thread checks that the hub still runs.
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
    /// The topics and services with publishers or servers of the domain itself, and how many each process has.
    present: BTreeMap<Subject, Links>,
    /// The number of interfaces that the Manager lets a node have.
    interfaces: Option<u32>,
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
    fn of<'a>(domain: &'a Domain, remote: &BTreeMap<(Subject, GatewayId), u64>) -> Self {
        let of_domain = |it: InterfaceView<'a>| {
            let node = domain.node(it.entity.node);
            let node = node.filter(|node| it.refused.is_none() && !is_of_gateway(node.name))?;
            let NodeView { uid, pid, .. } = node;
            Some((it.contract, Process { uid, pid }))
        };
        let contracts: Vec<_> = domain.interfaces().filter_map(of_domain).collect();
        let mut state = Self {
            interfaces: domain
                .limits()
                .and_then(|it| it.of(Limit::InterfacesPerSession)),
            ..Self::default()
        };
        let mut topics = BTreeMap::new();
        for (contract, process) in &contracts {
            match contract {
                Contract::Publisher { topic, data, offer } => {
                    let topic = topics.entry((topic, data));
                    let (reliable, latched, links) = topic.or_insert((false, 0, Links::new()));
                    *reliable |= offer.reliable;
                    // Each publisher keeps its own latched messages.
                    *latched = QOS_MAX.min(*latched + offer.latched);
                    *links.entry(*process).or_default() += 1;
                }
                Contract::Server {
                    service,
                    request,
                    reply,
                    ..
                } => {
                    let service = Subject::Service {
                        name: service.clone(),
                        request: request.clone(),
                        reply: reply.clone(),
                    };
                    let links = state.present.entry(service).or_default();
                    *links.entry(*process).or_default() += 1;
                }
                Contract::Subscriber { .. } | Contract::Client { .. } => {}
            }
        }
        let topics = topics.into_iter();
        let topic = |((name, data), (reliable, latched, links)): ((&Name, &TypeId), _)| {
            let topic = Subject::Topic {
                name: name.clone(),
                data: data.clone(),
                reliable,
                latched,
            };
            (topic, links)
        };
        state.present.extend(topics.map(topic));
        for ((subject, origin), generation) in remote {
            let takes = |(contract, _): &(&Contract, Process)| depth(contract, subject);
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
        let links = |subject: &Subject, links| LocalEvent::Links {
            subject: subject.clone(),
            links,
        };
        let gone = self
            .present
            .keys()
            .filter(|it| !now.present.contains_key(it));
        let new = now
            .present
            .keys()
            .filter(|it| !self.present.contains_key(it));
        let linked = (now.present.iter()).filter(|(it, links)| self.present.get(it) != Some(links));
        let interfaces = now.interfaces.filter(|_| self.interfaces != now.interfaces);
        // One is the server of status reports.
        let interfaces = interfaces.map(|it| LocalEvent::Interfaces {
            most: u64::from(it).saturating_sub(1),
        });
        let left = self.taken.keys().filter(|it| !now.taken.contains_key(it));
        let other = (now.taken.iter()).filter(|(it, taken)| self.taken.get(it) != Some(taken));
        interfaces
            .into_iter()
            .chain(linked.map(|(it, now)| links(it, now.clone())))
            .chain(gone.clone().map(|it| present(it, false)))
            .chain(gone.map(|it| links(it, Links::new())))
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

#[cfg(test)]
mod tests;
