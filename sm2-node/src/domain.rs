//! The domain as a node sees it: nodes, interfaces and links, as a snapshot or as a stream of
//! changes, and why two interfaces are not linked.
//!
//! [`Node::snapshot`] returns a [`Domain`], [`Node::watch`] a [`Watch`], [`Node::why`] a [`Verdict`].

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use sm2_io::CounterView;
pub use sm2_proto::control::{Change, Item, Key, Limits, Peer, UnlinkedReason};
use sm2_proto::domain::{Ask, Mirror, nearest, why};
pub use sm2_proto::domain::{Domain, Finding, Near, Verdict};
pub use sm2_proto::{
    Contract, Demand, EntityId, InterfaceId, Kind, LinkId, NodeId, Offer, ServiceQos,
};
use sm2_proto::{Instant, TypeId};

use crate::driver::{Answer, Followed, Lost, Question, Shared, Ticket};
pub use crate::error::QueryError;
use crate::handle::{Handle, until};
use crate::node::Node;
use crate::schema::{SchemaError, check_schema};

/// What a node can ask about its domain. Each call waits for the Manager at most as long as
/// [`NodeBuilder::manager_timeout`](crate::NodeBuilder::manager_timeout) says, also if that Manager goes and another
/// one comes meanwhile. Several threads may ask at a time: each gets its turn.
impl Node {
    /// The whole domain as it is at one revision (SM2-WCH-003), which includes
    /// all that this node was granted before.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    pub fn snapshot(&self) -> Result<Domain, QueryError> {
        let mut reader = Reader::new(&self.shared);
        reader.read(until(Some(self.shared.manager_timeout)))?;
        Ok(std::mem::take(&mut reader.mirror).into_domain())
    }

    /// Follows the domain: see [`Watch`].
    #[must_use]
    pub fn watch(&self) -> Watch {
        Watch {
            reader: Reader::new(&self.shared),
        }
    }

    /// Why two interfaces are linked, or why they are not. Their order does not matter.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    pub fn why(&self, one: EntityId, other: EntityId) -> Result<Verdict, QueryError> {
        Ok(why(&self.snapshot()?, one, other))
    }

    /// The counters of a node: of its interfaces, and of its ends of links. They go on counting
    /// while they are looked at, and looking costs that node nothing. `None` if it is not
    /// there, or keeps none.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    //= SM2-CNT-002
    pub fn inspect(&self, node: NodeId) -> Result<Option<CounterView>, QueryError> {
        let deadline = until(Some(self.shared.manager_timeout));
        match self.shared.ask(&Question::Inspect(node), deadline)? {
            Answer::Counters(Some(file)) => Ok(Some(CounterView::open(file)?)),
            _ => Ok(None),
        }
    }

    /// The schema text of a type (SPEC Annex A), if a node that is there uses it and knows its
    /// text. `sm2_proto::schema` reads it.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    //= SM2-SCH-002
    pub fn describe(&self, data: &TypeId) -> Result<Option<String>, QueryError> {
        let deadline = until(Some(self.shared.manager_timeout));
        match self
            .shared
            .ask(&Question::Describe(data.clone()), deadline)?
        {
            Answer::Schema(text) => Ok(text),
            _ => Ok(None),
        }
    }

    /// Lets all tools of the domain know what a type looks like, as long as this node lives. For
    /// tools that handle types which they were not built with: what is declared with
    /// a type of one's own is registered by itself ([`Message::schema`](crate::Message::schema)).
    ///
    /// # Errors
    ///
    /// See [`SchemaError`]; nothing is registered then.
    pub fn register_schema(&self, data: TypeId, text: &str) -> Result<(), SchemaError> {
        check_schema(&data, text)?;
        let (shared, text) = (&self.shared, text.to_owned());
        shared.driven().register_schema(data, text, &shared.epoll);
        Ok(())
    }
}

impl Handle {
    /// What comes closest to a counterpart of this interface, and why it is none.
    pub(crate) fn why(&self) -> Result<Vec<Near>, QueryError> {
        let mut reader = Reader::new(&self.shared);
        let until = until(Some(self.shared.manager_timeout));
        // Numbers of nodes are the Manager's: what counts is how the one calls us that was asked.
        let node = loop {
            reader.read(until)?;
            let inner = self.shared.lock();
            match inner.node_id() {
                Some(node) if inner.epoch() == Some(reader.epoch) => break node,
                _ => drop(inner),
            }
            reader.restart();
        };
        let entity = EntityId {
            node,
            interface: self.id,
        };
        Ok(nearest(reader.mirror.domain(), entity))
    }
}

/// Follows a domain: it knows all of it at one revision, and goes from there to later ones
/// when it is [asked](Self::wait).
///
/// It is never told more than it asks for: one that is slow only sees larger steps. When another
/// Manager has taken over, the next step is the difference between the last state that the old
/// one told and the first that the new one does (nodes have other numbers then).
pub struct Watch {
    reader: Reader,
}

impl Watch {
    /// The domain at the last revision that this has come to; empty before the first
    /// [`wait`](Self::wait).
    #[must_use]
    pub const fn domain(&self) -> &Domain {
        self.reader.mirror.domain()
    }

    /// Waits for changes, without a time limit (also for a Manager), applies them to
    /// [`domain`](Self::domain), and returns them: each item at most once. The first call returns
    /// the whole domain.
    ///
    /// # Errors
    ///
    /// See [`QueryError`]; the next call starts afresh.
    pub fn wait(&mut self) -> Result<Vec<Change>, QueryError> {
        self.wait_until(None)
    }

    /// As [`wait`](Self::wait), for at most `timeout`; the result is empty if nothing changed.
    ///
    /// # Errors
    ///
    /// As [`wait`](Self::wait).
    pub fn wait_timeout(&mut self, timeout: Duration) -> Result<Vec<Change>, QueryError> {
        self.wait_until(until(Some(timeout)))
    }

    /// As [`wait`](Self::wait), but never waits; the result is empty if nothing changed.
    ///
    /// # Errors
    ///
    /// As [`wait`](Self::wait).
    pub fn try_wait(&mut self) -> Result<Vec<Change>, QueryError> {
        self.wait_until(Some(Instant(0)))
    }

    //= SM2-WCH-001, SM2-WCH-003
    fn wait_until(&mut self, until: Option<Instant>) -> Result<Vec<Change>, QueryError> {
        loop {
            let changes = match self.reader.step(until) {
                Ok(changes) => changes,
                Err(QueryError::TimedOut | QueryError::ManagerGone(_)) => return Ok(Vec::new()),
                Err(error) => {
                    self.reader.restart();
                    return Err(error);
                }
            };
            // A Manager that was restarted may tell the same as the one before.
            if !changes.is_empty() {
                return Ok(changes);
            }
        }
    }
}

impl fmt::Debug for Watch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Watch")
            .field("revision", &self.domain().revision())
            .finish_non_exhaustive()
    }
}

/// A mirror, and where its answers come from.
struct Reader {
    shared: Arc<Shared>,
    mirror: Mirror,
    /// Of the Manager that the mirror is of.
    epoch: u64,
    /// Of the last page: changes that do not lead there leave the mirror between two states.
    revision: u64,
    /// A page that is on its way.
    asked: Option<Ticket>,
    /// Who collects what changes after the mirror's revision, or while its pages are read.
    follower: Option<Ticket>,
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.shared.abandon(self.asked);
        self.follow(None);
    }
}

impl Reader {
    fn new(shared: &Arc<Shared>) -> Self {
        Self {
            shared: Arc::clone(shared),
            mirror: Mirror::new(),
            epoch: 0,
            revision: 0,
            asked: None,
            follower: None,
        }
    }

    /// Asks until the mirror is exact.
    fn read(&mut self, until: Option<Instant>) -> Result<(), QueryError> {
        while self.mirror.ask().is_some() {
            self.step(until)?;
        }
        Ok(())
    }

    /// Asks once for what the mirror needs, or for what comes after it if it is exact. What
    /// has changed, if that made it exact again.
    fn step(&mut self, until: Option<Instant>) -> Result<Vec<Change>, QueryError> {
        match self.mirror.ask() {
            Some(Ask::Page { after: None }) => self.page(&Question::FirstPage, until),
            Some(Ask::Page { after: Some(key) }) => self.page(&Question::Page(key), until),
            Some(Ask::Changes { after }) => self.changes(after, until),
            None => {
                let after = self.mirror.domain().revision();
                if self.follower.is_none() {
                    self.follower = Some(self.shared.follow(self.epoch, after));
                }
                self.changes(after, until)
            }
        }
    }

    fn page(
        &mut self,
        question: &Question,
        until: Option<Instant>,
    ) -> Result<Vec<Change>, QueryError> {
        let answer = self.shared.ask_once(question, &mut self.asked, until)?;
        let Some(Answer::Page(page)) = answer else {
            return Ok(self.restart());
        };
        if page.follower.is_some() {
            self.follow(page.follower);
            self.epoch = page.epoch;
        } else if page.epoch != self.epoch {
            return Ok(self.restart());
        }
        self.revision = page.revision;
        Ok(self.mirror.page(page.revision, page.items, page.next)?)
    }

    fn changes(&mut self, after: u64, until: Option<Instant>) -> Result<Vec<Change>, QueryError> {
        let Some(follower) = self.follower else {
            return Ok(self.restart());
        };
        let wanted = after.saturating_add(1).max(self.revision);
        let followed = self.shared.wait_followed(follower, wanted, until);
        match followed.map_err(QueryError::Io)? {
            Some(Ok(Followed { revision, changes })) => {
                Ok(self.mirror.changes(revision, Some(changes), false)?)
            }
            Some(Err(Lost)) => Ok(self.restart()),
            None => Err(self.shared.too_late()),
        }
    }

    fn follow(&mut self, follower: Option<Ticket>) {
        if let Some(before) = std::mem::replace(&mut self.follower, follower) {
            self.shared.unfollow(before);
        }
    }

    fn restart(&mut self) -> Vec<Change> {
        self.follow(None);
        self.mirror.restart();
        Vec::new()
    }
}
