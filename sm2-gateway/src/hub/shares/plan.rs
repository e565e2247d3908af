//! The topics that have to be given back to make room.

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::gateway::Subject;

use super::room::{Links, Process, Room, need};

/// A step of a plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// The gateway takes the topic no longer.
    GiveUp(Subject),
    /// This process holds the topic from now on.
    Move(Subject, Process),
}

/// The state after some steps.
pub(super) struct Plan<'a> {
    held: BTreeMap<Process, u64>,
    used: Room,
    /// The topics that each process holds. A process gives back the last one first.
    topics: BTreeMap<Process, BTreeSet<Topic<'a>>>,
    steps: Vec<Step>,
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Topic<'a> {
    links_of_others: u64,
    number: u64,
    subject: &'a Subject,
    links: &'a Links,
}

impl<'a> Topic<'a> {
    fn held_by(self, holder: Process) -> Self {
        let others = self.links.iter().filter(|(it, _)| **it != holder);
        Self {
            links_of_others: others.map(|(_, count)| count).sum(),
            ..self
        }
    }
}

impl<'a> Plan<'a> {
    /// No steps yet. `taken` has the holder, the number and the links of each topic.
    pub(super) fn new(
        held: &BTreeMap<Process, u64>,
        used: Room,
        taken: impl Iterator<Item = (Process, u64, &'a Subject, &'a Links)>,
    ) -> Self {
        let mut topics = BTreeMap::<_, BTreeSet<_>>::new();
        for (holder, number, subject, links) in taken {
            let topic = Topic {
                links_of_others: 0,
                number,
                subject,
                links,
            };
            topics
                .entry(holder)
                .or_default()
                .insert(topic.held_by(holder));
        }
        Self {
            held: held.clone(),
            used,
            topics,
            steps: Vec::new(),
        }
    }

    /// The room that is used after the steps.
    pub(super) const fn used(&self) -> Room {
        self.used
    }

    pub(super) fn into_steps(self) -> Vec<Step> {
        self.steps
    }

    /// Lets the process that holds most give back a topic, or another process take it over. `None` if no process holds
    /// more than `least`.
    pub(super) fn step(&mut self, least: u64) -> Option<()> {
        let (&process, &most) = self.held.iter().max_by_key(|(it, held)| (**held, **it))?;
        if most <= least {
            return None;
        }
        let topic = self.topics.get_mut(&process)?.pop_last()?;
        let needed = need(topic.links).descriptors;
        self.subtract(process, needed);
        let held = |it: &Process| self.held.get(it).copied().unwrap_or(0);
        let heir = (topic.links.keys()).min_by_key(|it| (held(it), **it));
        let heir = heir.copied().filter(|it| held(it) + needed < most);
        if let Some(heir) = heir.filter(|it| *it != process) {
            *self.held.entry(heir).or_default() += needed;
            self.topics
                .entry(heir)
                .or_default()
                .insert(topic.held_by(heir));
            self.steps.push(Step::Move(topic.subject.clone(), heir));
        } else {
            self.used = self.used.without(need(topic.links));
            self.steps.push(Step::GiveUp(topic.subject.clone()));
        }
        Some(())
    }

    fn subtract(&mut self, process: Process, needed: u64) {
        if let Some(held) = self.held.get_mut(&process) {
            *held = held.saturating_sub(needed);
        }
    }
}
