//! What the domain has, and what it takes of what is shown.

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
    names::is_gateways,
};

/// How long the end of a gateway may go unnoticed here.
const LOOK: Duration = Duration::from_secs(1);
/// Where there is no Manager, waiting for one takes no time.
const PAUSE: Duration = Duration::from_millis(100);

/// The topics that are shown.
#[derive(Clone, Debug, Default)]
pub(super) struct Shown(Arc<Mutex<Topics>>);

#[derive(Debug, Default)]
struct Topics {
    /// Each with a number of its own: one that is hidden and shown again is another.
    numbers: BTreeMap<(Subject, GatewayId), u64>,
    last: u64,
}

impl Shown {
    pub(super) fn insert(&self, subject: &Subject, origin: GatewayId) {
        let mut topics = self.lock();
        topics.last += 1;
        let number = topics.last;
        topics.numbers.insert((subject.clone(), origin), number);
    }

    pub(super) fn remove(&self, what: &(Subject, GatewayId)) {
        self.lock().numbers.remove(what);
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Topics> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What is known of the domain.
#[derive(Debug, Default, PartialEq, Eq)]
struct View {
    present: BTreeSet<Subject>,
    /// How many messages wait at most, and the number of what is shown: what is shown anew is not
    /// taken until the hub hears so.
    taken: BTreeMap<(Subject, GatewayId), (u16, u64)>,
}

/// Follows the domain on a thread of its own, as long as somebody wants to know.
pub(super) fn start(node: &Node, shown: Shown, hub: HubHandle) -> io::Result<()> {
    let mut watch = node.watch();
    let follow = move || {
        let mut view = View::default();
        while !hub.is_closed() {
            match watch.wait_timeout(LOOK) {
                Ok(changes) if changes.is_empty() => thread::sleep(PAUSE),
                Ok(_) => {}
                Err(error) => {
                    tracing::warn!(%error, "cannot follow the domain");
                    thread::sleep(PAUSE);
                    continue;
                }
            }
            let now = View::of(watch.domain(), &shown.lock().numbers);
            for event in view.difference(&now) {
                if hub.blocking_send(HubEvent::Local(event)).is_err() {
                    return;
                }
            }
            view = now;
        }
    };
    let thread = thread::Builder::new().name("watch".to_owned());
    thread.spawn(follow).map(drop)
}

impl View {
    fn of(domain: &Domain, shown: &BTreeMap<(Subject, GatewayId), u64>) -> Self {
        let is_own = |it: &InterfaceView<'_>| {
            let node = domain.node(it.entity.node);
            it.refused.is_none() && node.is_some_and(|node| !is_gateways(node.name))
        };
        let contracts: Vec<&Contract> = (domain.interfaces())
            .filter(is_own)
            .map(|it| it.contract)
            .collect();
        let mut view = Self::default();
        let mut topics = BTreeMap::new();
        for contract in &contracts {
            match contract {
                Contract::Publisher { topic, data, offer } => {
                    let (reliable, latched) = topics.entry((topic, data)).or_insert((false, 0));
                    *reliable |= offer.reliable;
                    // Each of the publishers keeps so many.
                    *latched = QOS_MAX.min(*latched + offer.latched);
                }
                Contract::Server {
                    service,
                    request,
                    reply,
                    ..
                } => {
                    view.present.insert(Subject::Service {
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
        view.present.extend(topics.map(topic));
        for ((subject, origin), number) in shown {
            let takes = |contract: &&Contract| depth(contract, subject);
            if let Some(depth) = contracts.iter().filter_map(takes).max() {
                let taken = (depth, *number);
                view.taken.insert((subject.clone(), *origin), taken);
            }
        }
        view
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

/// How many messages wait for this subscriber, if it takes that topic.
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
