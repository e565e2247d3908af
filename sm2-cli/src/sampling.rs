//! Reads the counters of nodes from the files that every node keeps (SPEC section 12). Nothing is sent to a
//! node, and no node notices.

use std::{
    collections::{BTreeSet, HashMap},
    time::Duration,
};

use sm2_io::{CounterView, clock};
use sm2_node::Node;
use sm2_node::domain::QueryError;
use sm2_proto::{
    EntityId, Instant, InterfaceId, Kind, LinkId, Name, NodeId,
    counters::{Entry, Rate, Summary},
    domain::{Domain, LinkView},
};

use crate::{error::CliError, view::View};

/// Reads the counters of nodes repeatedly.
#[derive(Debug)]
pub(crate) struct Sampler {
    /// The epoch of the Manager that numbered the nodes. Another Manager uses other numbers.
    epoch: Option<u64>,
    /// The numbers of the nodes, as far as they are known.
    numbers: HashMap<Name, NodeId>,
    /// The counter files, with the node's number at the time of opening. A restarted node has another number
    /// and another file.
    files: HashMap<Name, (NodeId, CounterView)>,
}

/// The counters of some nodes at about one moment.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    at: Instant,
    /// By the node's name, which stays the same when a Manager takes over.
    entries: HashMap<End, Entry>,
    /// The nodes without counters, or whose counters could not be read.
    pub(crate) silent: BTreeSet<Name>,
}

/// An interface as a whole, or its end of one link.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct End {
    node: Name,
    interface: InterfaceId,
    link: Option<LinkId>,
}

/// The counters of the two ends of a link, in the direction of messages or requests. An end whose node keeps no
/// counters has `None`.
pub(crate) struct Ends<'s> {
    /// The publisher or client.
    pub(crate) sender: EntityId,
    /// The subscriber or server.
    pub(crate) receiver: EntityId,
    pub(crate) sent: Option<&'s Entry>,
    pub(crate) taken: Option<&'s Entry>,
}

impl Sampler {
    /// Creates a sampler without samples.
    pub(crate) fn new() -> Self {
        Self {
            epoch: None,
            numbers: HashMap::new(),
            files: HashMap::new(),
        }
    }

    /// Reads the counters of these nodes.
    ///
    /// # Errors
    ///
    /// [`CliError::Query`].
    pub(crate) fn look(
        &mut self,
        node: &Node,
        domain: &Domain,
        wanted: &BTreeSet<NodeId>,
    ) -> Result<Sample, CliError> {
        let wanted: HashMap<Name, NodeId> = (wanted.iter())
            .filter_map(|&id| Some((domain.node(id)?.name.clone(), id)))
            .collect();
        self.files.retain(|name, _| wanted.contains_key(name));
        self.open(node, &wanted)?;
        let files = wanted.into_keys().map(|name| {
            let file = self.files.get(&name).map(|(_, file)| file);
            (name, file)
        });
        Ok(Sample::new(clock::now(), files))
    }

    /// Asks for the files that are not open yet, or that belong to an earlier run of a node.
    fn open(&mut self, node: &Node, wanted: &HashMap<Name, NodeId>) -> Result<(), CliError> {
        // Without a Manager there is nobody to ask. Open files stay valid.
        let Some(epoch) = node.epoch().filter(|_| node.is_connected()) else {
            return Ok(());
        };
        if self.epoch.replace(epoch) != Some(epoch) {
            self.numbers.clear();
            self.files.clear();
        }
        if wanted
            .iter()
            .any(|(name, id)| self.numbers.get(name) != Some(id))
        {
            // The numbers of the caller may be those of another Manager.
            let domain = match node.snapshot() {
                Ok(domain) => domain,
                Err(QueryError::TimedOut | QueryError::ManagerGone(_)) => return Ok(()),
                Err(error) => return Err(error.into()),
            };
            let numbers = domain.nodes().map(|it| (it.name.clone(), it.node));
            self.numbers = numbers.collect();
        }
        for (name, &id) in self
            .numbers
            .iter()
            .filter(|(name, _)| wanted.contains_key(*name))
        {
            if self.files.get(name).is_some_and(|(of, _)| *of == id) {
                continue;
            }
            self.files.remove(name);
            match node.inspect(id) {
                Ok(Some(file)) => drop(self.files.insert(name.clone(), (id, file))),
                Ok(None)
                // An invalid file is skipped: one node must not spoil the figures of the others.
                | Err(
                    QueryError::TimedOut | QueryError::ManagerGone(_) | QueryError::Counters(_),
                ) => {}
                Err(error) => return Err(error.into()),
            }
        }
        if node.epoch() != Some(epoch) {
            // Some of these answers came from another Manager, for other nodes.
            self.epoch = None;
            self.files.clear();
        }
        Ok(())
    }
}

impl Sample {
    /// The counters of these nodes, as far as they can be read, for what is complete without them.
    pub(crate) fn if_known(node: &Node, domain: &Domain, wanted: &BTreeSet<NodeId>) -> Self {
        let sample = Sampler::new().look(node, domain, wanted);
        sample.unwrap_or_else(|_| Self::new(clock::now(), []))
    }

    /// Reads the files of these nodes. A node without a file is `silent`.
    pub(crate) fn new<'f>(
        at: Instant,
        files: impl IntoIterator<Item = (Name, Option<&'f CounterView>)>,
    ) -> Self {
        let mut sample = Self {
            at,
            entries: HashMap::new(),
            silent: BTreeSet::new(),
        };
        for (name, file) in files {
            match file {
                Some(file) => sample.add(&name, file),
                None => drop(sample.silent.insert(name)),
            }
        }
        sample
    }

    fn add(&mut self, node: &Name, file: &CounterView) {
        // An entry that is always being written is left out of this sample.
        for entry in file.entries().filter_map(|(_, entry)| entry.ok()) {
            let end = End {
                node: node.clone(),
                interface: entry.interface,
                link: entry.link,
            };
            self.entries.insert(end, entry);
        }
    }

    /// The counters of an interface as a whole.
    pub(crate) fn interface(&self, domain: &Domain, entity: EntityId) -> Option<&Entry> {
        self.end(domain, entity, None)
    }

    /// Those of these interfaces whose `count` is not zero: their titles, and that number.
    pub(crate) fn counted<'a>(
        &'a self,
        view: &'a View<'_>,
        of: &'a [EntityId],
        count: fn(&Entry) -> u64,
    ) -> impl Iterator<Item = (String, u64)> + 'a {
        of.iter().filter_map(move |&entity| {
            let count = count(self.interface(view.domain, entity)?);
            (count > 0).then(|| (view.title(entity), count))
        })
    }

    /// The counters of the offering side of a link.
    pub(crate) fn offering(&self, domain: &Domain, link: &LinkView) -> Option<&Entry> {
        self.end(domain, link.offering, Some(link.link))
    }

    /// The counters of the demanding side of a link.
    pub(crate) fn demanding(&self, domain: &Domain, link: &LinkView) -> Option<&Entry> {
        self.end(domain, link.demanding, Some(link.link))
    }

    /// The counters of both ends of a link, in the direction of messages or requests.
    pub(crate) fn ends(&self, view: &View<'_>, link: &LinkView) -> Ends<'_> {
        let offering = view.domain.interface(link.offering);
        let is_service = offering.is_some_and(|it| it.contract.kind() == Kind::Server);
        let (sender, receiver) = match is_service {
            true => (link.demanding, link.offering),
            false => (link.offering, link.demanding),
        };
        Ends {
            sender,
            receiver,
            sent: self.end(view.domain, sender, Some(link.link)),
            taken: self.end(view.domain, receiver, Some(link.link)),
        }
    }

    /// Whether messages were dropped or deadlines missed, at any time.
    pub(crate) fn has_losses(&self) -> bool {
        let mut entries = self.entries.values();
        entries.any(|it| it.fates.dropped() > 0 || it.missed_deadlines > 0)
    }

    /// The time when the counters were read.
    pub(crate) const fn at(&self) -> Instant {
        self.at
    }

    fn end(&self, domain: &Domain, entity: EntityId, link: Option<LinkId>) -> Option<&Entry> {
        let end = End {
            node: domain.node(entity.node)?.name.clone(),
            interface: entity.interface,
            link,
        };
        self.entries.get(&end)
    }

    /// The time from an earlier sample to this one.
    pub(crate) fn since(&self, earlier: &Self) -> Duration {
        self.at.since(earlier.at)
    }

    /// The rate of an interface's counters since an earlier sample.
    pub(crate) fn rate(&self, earlier: &Self, domain: &Domain, entity: EntityId) -> Option<Rate> {
        let now = self.interface(domain, entity)?;
        let before = earlier.interface(domain, entity)?;
        now.rate_since(before, self.since(earlier))
    }
}

/// The median of the last delays of a receiving side. `None` if there are no delays.
pub(crate) fn median_ns(entry: &Entry) -> Option<u64> {
    let mut recent: Vec<_> = entry.recent().collect();
    recent.sort_unstable();
    recent.get(recent.len().checked_sub(1)? / 2).copied()
}

/// A summary of durations in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub(crate) struct Millis {
    pub(crate) count: u32,
    pub(crate) mean: f64,
    pub(crate) min: f64,
    pub(crate) max: f64,
    pub(crate) std_dev: f64,
}

impl From<Summary> for Millis {
    fn from(of: Summary) -> Self {
        Self {
            count: of.count,
            mean: millis(of.mean_ns),
            min: millis(of.min_ns),
            max: millis(of.max_ns),
            std_dev: millis(of.std_dev_ns),
        }
    }
}

/// Nanoseconds as milliseconds, rounded to microseconds.
pub(crate) fn millis(nanos: u64) -> f64 {
    (nanos as f64 / 1e3).round() / 1e3
}

/// Rounded to two decimals.
pub(crate) fn hundredths(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests;
