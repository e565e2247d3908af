//! Requests of the program to the Manager, from any thread, and the answers.
//!
//! At most one question of each kind is in flight. The others wait in the order in which they were
//! asked, so that no thread starves and the Manager's queue for this node stays short. When a
//! session ends, its questions are dropped. A thread that waits for an answer learns of this, and
//! asks the next Manager.
//!
//! A CHANGES answer belongs to no particular question: the changes after revision `a` are useful
//! for every follower at revision `a` or later (SM2-WCH-002). Therefore one WATCH serves all
//! [`Follower`]s.

mod answers;
mod ask;

use std::collections::{HashMap, VecDeque};
use std::os::fd::OwnedFd;

use sm2_proto::control::{Change, Item, Key, ReloadOutcome};
use sm2_proto::node::Input;
use sm2_proto::{EntityId, InterfaceId, NodeId, TypeId};

use super::limits::CHANGES;
use super::session::SessionDriver;

/// A question that is answered exactly once.
#[derive(Clone, Debug)]
pub(crate) enum Question {
    /// Asks for the first items. From the revision of this page on, changes are collected.
    FirstPage,
    /// Asks for the items after this one.
    Page(Key),
    /// Asks for a node's counters.
    Inspect(NodeId),
    /// Asks for the schema text of a type.
    Describe(TypeId),
    /// Asks the Manager to read its access policy again.
    Reload,
}

/// An answer of the Manager.
#[derive(Debug)]
pub(crate) enum Answer {
    Page(Page),
    /// The file of a node's counters.
    Counters(Option<OwnedFd>),
    Schema(Option<String>),
    Reloaded(ReloadOutcome),
}

/// A part of the domain's state.
#[derive(Debug)]
pub(crate) struct Page {
    pub(crate) epoch: u64,
    pub(crate) revision: u64,
    pub(crate) items: Vec<Item>,
    pub(crate) next: Option<Key>,
    /// On the first page: the follower of the changes after this page.
    pub(crate) follower: Option<Ticket>,
}

/// The greatest key. The page after it is empty.
const LAST: Key = {
    let entity = EntityId {
        node: NodeId(u64::MAX),
        interface: InterfaceId(u64::MAX),
    };
    Key::Unlinked {
        offering: entity,
        demanding: entity,
    }
};

/// Identifies a question or a follower.
pub(crate) type Ticket = u64;

#[derive(Debug, Default)]
pub(super) struct Questions {
    last_ticket: Ticket,
    /// The queues of questions, by kind. The first question of each queue was sent.
    queues: [VecDeque<(Ticket, Question)>; 4],
    /// The answers that threads wait for; `None` until the answer comes.
    answers: HashMap<Ticket, Option<Answer>>,
    followers: HashMap<Ticket, Follower>,
    /// The revision after which changes were requested, if a WATCH is in flight.
    watching: Option<u64>,
}

/// A follower knows the domain at one revision and collects the changes after that revision.
#[derive(Debug)]
struct Follower {
    epoch: u64,
    revision: u64,
    /// Whether the last CHANGES frame was not the last of a series.
    more: bool,
    changes: Vec<Change>,
    /// Whether the next changes cannot be obtained.
    lost: bool,
}

/// The changes up to a revision.
#[derive(Debug)]
pub(crate) struct Followed {
    pub(crate) revision: u64,
    pub(crate) changes: Vec<Change>,
}

/// The changes cannot be obtained: the Manager has dropped them, or another Manager took over.
#[derive(Debug)]
pub(crate) struct Lost;

impl Questions {
    const fn kind(question: &Question) -> usize {
        match question {
            Question::FirstPage | Question::Page(_) => 0,
            Question::Inspect(_) => 1,
            Question::Describe(_) => 2,
            Question::Reload => 3,
        }
    }

    /// Queues a question. Returns the input that sends it, if no other question of its kind is in
    /// flight.
    fn ask(&mut self, question: Question) -> (Ticket, Option<Input<'static>>) {
        let ticket = self.ticket();
        self.answers.insert(ticket, None);
        let queue = &mut self.queues[Self::kind(&question)];
        let input = queue.is_empty().then(|| question.input());
        queue.push_back((ticket, question));
        (ticket, input)
    }

    /// Removes the question that was answered. Returns it if a thread still waits for the answer,
    /// and the input that sends the next question.
    fn answered(&mut self, kind: usize) -> (Option<(Ticket, Question)>, Option<Input<'static>>) {
        let (queue, answers) = (&mut self.queues[kind], &self.answers);
        let answered = queue.pop_front();
        queue.retain(|(ticket, _)| answers.contains_key(ticket));
        let next = queue.front().map(|(_, question)| question.input());
        (
            answered.filter(|(ticket, _)| answers.contains_key(ticket)),
            next,
        )
    }

    /// Asks for a page unless one is expected. No thread waits for the answer. Returns the input
    /// that sends the question.
    pub(super) fn expect_page(&mut self) -> Option<Input<'static>> {
        let question = Question::Page(LAST);
        if !self.queues[Self::kind(&question)].is_empty() {
            return None;
        }
        let (ticket, input) = self.ask(question);
        self.answers.remove(&ticket);
        input
    }

    fn follow(&mut self, epoch: u64, revision: u64) -> Ticket {
        let ticket = self.ticket();
        let follower = Follower {
            epoch,
            revision,
            more: false,
            changes: Vec::new(),
            lost: false,
        };
        self.followers.insert(ticket, follower);
        ticket
    }

    /// The changes that a follower has collected once it has reached this revision. Requests them
    /// if necessary; the caller drains the session.
    fn followed(
        &mut self,
        ticket: Ticket,
        revision: u64,
        session: &mut SessionDriver,
    ) -> Option<Result<Followed, Lost>> {
        let Some(follower) = self.followers.get_mut(&ticket) else {
            return Some(Err(Lost));
        };
        if !follower.lost && follower.revision >= revision && !follower.more {
            return Some(Ok(Followed {
                revision: follower.revision,
                changes: std::mem::take(&mut follower.changes),
            }));
        }
        let after = follower.revision;
        follower.lost |= session.epoch() != Some(follower.epoch);
        match self.watching {
            _ if follower.lost => Some(Err(Lost)),
            // Another follower waits for changes after a later revision, which may never come.
            Some(later) if later > after => Some(Err(Lost)),
            Some(_) => None,
            None => {
                self.watching = Some(after);
                session.tell(Input::Watch { after });
                None
            }
        }
    }

    const fn ticket(&mut self) -> Ticket {
        self.last_ticket += 1;
        self.last_ticket
    }

    //= SM2-WCH-003
    pub(super) fn changes(&mut self, revision: u64, changes: Option<&[Change]>, more: bool) {
        let Some(after) = self.watching.take() else {
            return;
        };
        // A follower before `after` would miss changes; a follower at `revision` or later knows all
        // of them.
        let of_use =
            |it: &&mut Follower| !it.lost && after <= it.revision && it.revision < revision;
        match changes {
            Some(changes) => {
                for follower in self.followers.values_mut().filter(of_use) {
                    follower.changes.extend_from_slice(changes);
                    follower.revision = revision;
                    follower.more = more;
                    if follower.changes.len() > CHANGES {
                        follower.changes = Vec::new();
                        follower.lost = true;
                    }
                }
            }
            None => {
                for follower in self.followers.values_mut() {
                    follower.lost |= follower.revision <= after;
                }
            }
        }
    }

    /// Drops a question whose thread no longer waits. The answer may already have come.
    fn abandon(&mut self, ticket: Ticket) {
        if let Some(Some(Answer::Page(page))) = self.answers.remove(&ticket)
            && let Some(follower) = page.follower
        {
            self.followers.remove(&follower);
        }
    }

    /// Drops all questions at the end of the session.
    pub(super) fn forget(&mut self) {
        self.queues.iter_mut().for_each(VecDeque::clear);
        self.answers.retain(|_, answer| answer.is_some());
        self.watching = None;
        for follower in self.followers.values_mut() {
            follower.lost = true;
        }
    }
}

impl Question {
    fn input(&self) -> Input<'static> {
        match self {
            Self::FirstPage => Input::Query { after: None },
            Self::Page(after) => Input::Query {
                after: Some(*after),
            },
            Self::Inspect(node) => Input::Inspect { node: *node },
            Self::Describe(data) => Input::Describe { data: data.clone() },
            Self::Reload => Input::Reload,
        }
    }
}
