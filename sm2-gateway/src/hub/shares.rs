//! Which topics and services of the domain the gateway takes, if it has no room for all that peers want.
//!
//! Other processes decide how many topics and services there are, and how many publishers or servers each one has. Each
//! link takes descriptors. So the processes share the room, as queues share a buffer under *longest queue drop*: a
//! process may use all of it until another one needs a part, and then the process that holds most gives back first.
//!
//! The descriptors of a topic are those of the subscription and of the link of each publisher. One process *holds* all
//! of them: of the processes with a publisher, one that held least when the gateway took the topic.
//!
//! 1. A wanted topic is taken if there is room.
//! 2. Otherwise it is taken if its process would then hold less than another one does: the process that holds most
//!    gives back a topic, as often as necessary. If that does not make enough room, nothing changes, and the topic
//!    waits.
//! 3. Before a process gives back a topic that others publish as well, one of these takes the topic over, if it then
//!    holds less. A process can therefore not make others lose topics by publishing them, too.
//! 4. A process first gives back the topics with the most links of other processes, then the newest.
//! 5. When there is room again, waiting topics are taken, first those of the process that holds least.
//!
//! A process that holds no more than an equal share of the room therefore keeps what it holds, whatever others do,
//! apart from topics with many links of others.

mod plan;
mod room;

use std::collections::{BTreeMap, VecDeque};

use sm2_proto::gateway::Subject;

use self::plan::{Plan, Step};
use self::room::need;
pub use self::room::{Links, Process, Room};

/// The process of topics whose links no event has named.
const UNKNOWN: Process = Process { uid: 0, pid: 0 };

/// The topics and services that the gateway takes of its domain, and those that wait.
#[derive(Debug)]
pub(super) struct Shares {
    room: Room,
    links: BTreeMap<Subject, Links>,
    wanted: BTreeMap<Subject, Wanted>,
    /// The descriptors that each process holds.
    held: BTreeMap<Process, u64>,
    /// The sum over all that is taken.
    used: Room,
    last: u64,
    changes: VecDeque<Change>,
}

/// A topic or service that a peer wants.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Wanted {
    /// The order in which peers began to want.
    number: u64,
    taken: Option<Taken>,
}

/// A topic or service that the gateway takes.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Taken {
    holder: Process,
    links: Links,
}

/// A decision.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// The gateway takes it from now on.
    Take(Subject),
    /// The gateway takes it no longer.
    GiveUp(Subject),
    /// A peer wants it, and there is no room.
    Wait(Subject),
}

impl Shares {
    pub(super) const fn new(room: Room) -> Self {
        Self {
            room,
            links: BTreeMap::new(),
            wanted: BTreeMap::new(),
            held: BTreeMap::new(),
            used: Room::NONE,
            last: 0,
            changes: VecDeque::new(),
        }
    }

    pub(super) fn poll(&mut self) -> Option<Change> {
        self.changes.pop_front()
    }

    /// The topics and services that peers want and that there is no room for.
    pub(super) fn waiting(&self) -> impl Iterator<Item = &Subject> {
        let waiting = self.wanted.iter().filter(|(_, it)| it.taken.is_none());
        waiting.map(|(subject, _)| subject)
    }

    /// A peer wants a topic or service.
    pub(super) fn want(&mut self, subject: Subject) {
        if self.wanted.contains_key(&subject) {
            return;
        }
        self.last += 1;
        let wanted = Wanted {
            number: self.last,
            taken: None,
        };
        self.wanted.insert(subject.clone(), wanted);
        // Nothing has changed for those that wait already.
        if !self.try_take(&subject) {
            self.changes.push_back(Change::Wait(subject));
        }
        self.invariants();
    }

    /// No peer wants it any more.
    pub(super) fn unwant(&mut self, subject: &Subject) {
        let was_taken = self.release(subject);
        self.wanted.remove(subject);
        if was_taken {
            self.take_waiting();
        }
        self.invariants();
    }

    /// The links of a topic or service have changed; none are left of one that is gone.
    pub(super) fn set_links(&mut self, subject: &Subject, links: Links) {
        let before = self.links_of(subject);
        match links.is_empty() {
            true => self.links.remove(subject),
            false => self.links.insert(subject.clone(), links),
        };
        let links = self.links_of(subject);
        if links == before {
            return;
        }
        let wanted = self.wanted.get_mut(subject);
        let was_wanted = wanted.is_some();
        if let Some(taken) = wanted.and_then(|it| it.taken.take()) {
            self.uncount(&taken);
            let holder = match links.contains_key(&taken.holder) {
                true => taken.holder,
                false => self.least(&links),
            };
            self.count(subject, Taken { holder, links });
        }
        if was_wanted {
            self.rebalance();
        }
        self.invariants();
    }

    pub(super) fn set_interfaces(&mut self, most: u64) {
        self.room.interfaces = most;
        self.rebalance();
        self.invariants();
    }

    /// Gives back what exceeds the room, and fills what is free.
    fn rebalance(&mut self) {
        if let Some(steps) = self.plan(Room::NONE, 0) {
            self.carry_out(steps);
        }
        self.take_waiting();
    }

    /// Takes waiting topics by rules 1 and 2.
    fn take_waiting(&mut self) {
        let waiting = self.wanted.iter().filter(|(_, it)| it.taken.is_none());
        let mut waiting: Vec<_> = waiting
            .map(|(subject, it)| {
                let process = self.least(&self.links_of(subject));
                (self.held(process), process, it.number, subject.clone())
            })
            .collect();
        waiting.sort();
        let mut rejected = None;
        for (_, process, _, subject) in waiting {
            // Most topics of a process need as much as the one before.
            if rejected != Some(process) && !self.try_take(&subject) {
                rejected = Some(process);
            }
        }
    }

    /// Takes a waiting topic, if rule 1 or 2 allows. Returns whether it did.
    fn try_take(&mut self, subject: &Subject) -> bool {
        let links = self.links_of(subject);
        let (more, holder) = (need(&links), self.least(&links));
        let Some(steps) = self.plan(more, self.held(holder) + more.descriptors) else {
            return false;
        };
        self.carry_out(steps);
        self.count(subject, Taken { holder, links });
        self.changes.push_back(Change::Take(subject.clone()));
        true
    }

    /// The steps that make room for `more`, if processes that hold more than `least` have enough to give back.
    fn plan(&self, more: Room, least: u64) -> Option<Vec<Step>> {
        if self.used.and(more).fits(self.room) {
            return Some(Vec::new());
        }
        if self.held.values().all(|it| *it <= least) {
            return None;
        }
        let taken = self.wanted.iter().filter_map(|(subject, it)| {
            let Taken { holder, links } = it.taken.as_ref()?;
            Some((*holder, it.number, subject, links))
        });
        let mut plan = Plan::new(&self.held, self.used, taken);
        while !plan.used().and(more).fits(self.room) {
            plan.step(least)?;
        }
        Some(plan.into_steps())
    }

    fn carry_out(&mut self, steps: Vec<Step>) {
        for step in steps {
            match step {
                Step::GiveUp(subject) => {
                    self.release(&subject);
                    self.changes.push_back(Change::Wait(subject));
                }
                Step::Move(subject, holder) => {
                    let wanted = self.wanted.get_mut(&subject);
                    if let Some(taken) = wanted.and_then(|it| it.taken.take()) {
                        self.uncount(&taken);
                        let links = taken.links;
                        self.count(&subject, Taken { holder, links });
                    }
                }
            }
        }
    }

    /// Stops taking a topic. Returns whether it was taken.
    fn release(&mut self, subject: &Subject) -> bool {
        let taken = self.wanted.get_mut(subject).and_then(|it| it.taken.take());
        if let Some(taken) = &taken {
            self.uncount(taken);
            self.changes.push_back(Change::GiveUp(subject.clone()));
        }
        taken.is_some()
    }

    fn links_of(&self, subject: &Subject) -> Links {
        let links = self.links.get(subject);
        links.cloned().unwrap_or_else(|| [(UNKNOWN, 1)].into())
    }

    fn held(&self, process: Process) -> u64 {
        self.held.get(&process).copied().unwrap_or(0)
    }

    /// The process with links that holds least.
    fn least(&self, links: &Links) -> Process {
        let processes = links.keys().copied();
        let least = processes.min_by_key(|it| (self.held(*it), *it));
        least.unwrap_or(UNKNOWN)
    }

    fn count(&mut self, subject: &Subject, taken: Taken) {
        let more = need(&taken.links);
        self.used = self.used.and(more);
        *self.held.entry(taken.holder).or_default() += more.descriptors;
        if let Some(it) = self.wanted.get_mut(subject) {
            it.taken = Some(taken);
        }
    }

    /// Takes back what [`count`](Self::count) added.
    fn uncount(&mut self, taken: &Taken) {
        let less = need(&taken.links);
        self.used = self.used.without(less);
        let left = self.held(taken.holder).saturating_sub(less.descriptors);
        match left {
            0 => self.held.remove(&taken.holder),
            _ => self.held.insert(taken.holder, left),
        };
    }

    /// Checks what holds between any two calls. The time that this takes grows with the number of topics.
    fn invariants(&self) {
        if !cfg!(debug_assertions) || self.wanted.len() > 512 {
            return;
        }
        let (mut used, mut held) = (Room::NONE, BTreeMap::new());
        for taken in self.wanted.values().filter_map(|it| it.taken.as_ref()) {
            assert!(taken.links.contains_key(&taken.holder));
            used = used.and(need(&taken.links));
            *held.entry(taken.holder).or_default() += need(&taken.links).descriptors;
        }
        assert_eq!((used, &held), (self.used, &self.held));
        assert!(used.fits(self.room));
    }
}

#[cfg(test)]
mod tests;
