//! The domain as a node sees it: nodes, interfaces and links, as a snapshot or as a stream of
//! changes, and why two interfaces are not linked.
//!
//! [`Node::snapshot`] returns a [`Domain`], [`Node::watch`] a [`Watch`], [`Node::why`] a [`Verdict`].

use std::fmt;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use sm2_io::CounterView;
use sm2_proto::control::ReloadOutcome;
pub use sm2_proto::control::{
    Change, Item, Key, Limit, LinkPeer, PolicyProblem, StatedLimit, StatedLimits, UnlinkedReason,
};
pub use sm2_proto::domain::Domain;
use sm2_proto::domain::{Ask, Mirror};
pub use sm2_proto::{
    Contract, DemandedQos, EntityId, InterfaceId, Kind, LinkId, NodeId, OfferedQos, Period,
    ServiceQos,
};
use sm2_proto::{Instant, TypeId};

use crate::driver::{Answer, ControlBell, Followed, Lost, Question, SharedNode, Ticket};
pub use crate::error::{QueryError, ReloadError};
pub use crate::explain::{Finding, Near, Verdict};
use crate::explain::{nearest, why};
use crate::handle::{Handle, until};
use crate::node::Node;
use crate::schema::{SchemaError, check_schema};

/// Queries about the domain. Each call waits for the Manager for at most
/// [`NodeBuilder::manager_timeout`](crate::NodeBuilder::manager_timeout), even if another Manager takes over
/// meanwhile. Several threads may query at the same time; their queries are answered one after the other.
impl Node {
    /// Returns the whole domain at one revision (SM2-WCH-003). It includes everything that this node was
    /// granted before the call.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    pub fn snapshot(&self) -> Result<Domain, QueryError> {
        let mut reader = Reader::new(&self.shared);
        reader.read(until(Some(self.shared.manager_timeout)))?;
        Ok(std::mem::take(&mut reader.mirror).into_domain())
    }

    /// Follows the domain's changes: see [`Watch`].
    #[must_use]
    pub fn watch(&self) -> Watch {
        Watch {
            reader: Reader::new(&self.shared),
            bell: None,
        }
    }

    /// Explains why two interfaces are linked, or why they are not. Their order does not matter.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    pub fn why(&self, one: EntityId, other: EntityId) -> Result<Verdict, QueryError> {
        Ok(why(&self.snapshot()?, one, other))
    }

    /// Opens the counters of a node: those of its interfaces and of its link ends. They continue to count
    /// while they are read, and reading costs that node nothing. `None` if there is no such node, or it has
    /// no counters.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    //= SM2-CNT-003
    pub fn inspect(&self, node: NodeId) -> Result<Option<CounterView>, QueryError> {
        let deadline = until(Some(self.shared.manager_timeout));
        match self.shared.ask(&Question::Inspect(node), deadline)? {
            Answer::Counters(Some(file)) => Ok(Some(CounterView::open(file)?)),
            _ => Ok(None),
        }
    }

    /// Returns the schema text of a type (SPEC Annex A), if a node of the domain uses the type and has
    /// registered its text. `sm2_proto::schema` parses it.
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

    /// Makes the Manager read the access policy of its domain again, and returns when the policy is applied:
    /// no node delivers anything that it denies. Only the Manager's user and root may do this.
    ///
    /// Nodes have 5 s to confirm the end of links that the policy denies, so `timeout` should be longer. If
    /// another Manager takes over meanwhile, this one is asked.
    ///
    /// # Errors
    ///
    /// See [`ReloadError`]. After an error other than [`ReloadError::Query`], the policy before is in force.
    //= SM2-ACC-016
    pub fn reload_policy(&self, timeout: Duration) -> Result<(), ReloadError> {
        let deadline = until(Some(timeout));
        match self.shared.ask(&Question::Reload, deadline)? {
            Answer::Reloaded(ReloadOutcome::NoPolicy) => Err(ReloadError::NoPolicy),
            Answer::Reloaded(ReloadOutcome::NotPermitted) => Err(ReloadError::NotPermitted),
            Answer::Reloaded(ReloadOutcome::Unusable { problem, text }) => {
                Err(ReloadError::Unusable { problem, text })
            }
            _ => Ok(()),
        }
    }

    /// Registers a schema text, so that tools of the domain can decode the type for as long as this node
    /// lives. Only tools that handle types unknown at compile time need this: a declaration registers the
    /// type's own text ([`Message::schema`](crate::Message::schema)).
    ///
    /// # Errors
    ///
    /// See [`SchemaError`]. After an error, nothing is registered.
    pub fn register_schema(&self, data: TypeId, text: &str) -> Result<(), SchemaError> {
        check_schema(&data, text)?;
        let (shared, text) = (&self.shared, text.to_owned());
        shared
            .lock_driven()
            .register_schema(data, text, &shared.sets);
        Ok(())
    }
}

impl Handle {
    /// Returns the interfaces that come closest to matching this one, with the reasons why they do not.
    pub(crate) fn why(&self) -> Result<Vec<Near>, QueryError> {
        let mut reader = Reader::new(&self.shared);
        let until = until(Some(self.shared.manager_timeout));
        // Each Manager numbers nodes anew, so the number must come from the Manager that answered.
        let node = loop {
            reader.read(until)?;
            let control = self.shared.lock();
            match control.node_id() {
                Some(node) if control.epoch() == Some(reader.epoch) => break node,
                _ => drop(control),
            }
            reader.restart();
        };
        let entity = EntityId {
            node,
            interface: self.interface.id,
        };
        Ok(nearest(reader.mirror.domain(), entity))
    }
}

/// Follows a domain: holds its state at one revision, and advances to later revisions when
/// [asked](Self::wait).
///
/// A [`WaitSet`](crate::WaitSet::add_watch) can wait for the changes of a domain together with other things.
///
/// A slow reader receives larger steps, never a backlog. After another Manager has taken over, the next step
/// is the difference between the last state of the old Manager and the first state of the new one. Nodes have
/// new numbers then.
pub struct Watch {
    reader: Reader,
    /// The descriptor for wait sets; `None` before the watch was added to one.
    bell: Option<Arc<ControlBell>>,
}

impl Watch {
    /// Returns the domain at the current revision; empty before the first [`wait`](Self::wait).
    #[must_use]
    pub const fn domain(&self) -> &Domain {
        self.reader.mirror.domain()
    }

    /// Waits for changes, without a time limit (also for a Manager). Applies them to [`domain`](Self::domain)
    /// and returns them, each item at most once. The first call returns the whole domain.
    ///
    /// # Errors
    ///
    /// See [`QueryError`]. After an error, the next call starts from an empty domain.
    pub fn wait(&mut self) -> Result<Vec<Change>, QueryError> {
        self.wait_until(None)
    }

    /// As [`wait`](Self::wait), for at most `timeout`. Returns an empty list if nothing changed.
    ///
    /// # Errors
    ///
    /// As [`wait`](Self::wait).
    pub fn wait_timeout(&mut self, timeout: Duration) -> Result<Vec<Change>, QueryError> {
        self.wait_until(until(Some(timeout)))
    }

    /// As [`wait`](Self::wait), but never waits. Returns an empty list if nothing changed.
    ///
    /// # Errors
    ///
    /// As [`wait`](Self::wait).
    pub fn try_wait(&mut self) -> Result<Vec<Change>, QueryError> {
        self.wait_until(Some(Instant(0)))
    }

    /// The node, and the descriptor for a wait set: readable while [`try_wait`](Self::try_wait) may find changes.
    pub(crate) fn bell(&mut self) -> io::Result<(&SharedNode, Arc<ControlBell>)> {
        let bell = match &self.bell {
            Some(bell) => Arc::clone(bell),
            None => Arc::new(ControlBell::new(&self.reader.shared)?),
        };
        self.bell = Some(Arc::clone(&bell));
        Ok((&self.reader.shared, bell))
    }

    fn wait_until(&mut self, until: Option<Instant>) -> Result<Vec<Change>, QueryError> {
        // First, so that a change after the look below rings it again.
        if let Some(bell) = &self.bell {
            bell.clear();
        }
        let changes = self.read(until);
        if let Some(bell) = &self.bell
            && !matches!(&changes, Ok(none) if none.is_empty())
        {
            bell.ring();
        }
        changes
    }

    //= SM2-WCH-001, SM2-WCH-003
    fn read(&mut self, until: Option<Instant>) -> Result<Vec<Change>, QueryError> {
        loop {
            let changes = match self.reader.step(until) {
                Ok(changes) => changes,
                Err(QueryError::TimedOut | QueryError::ManagerGone(_)) => return Ok(Vec::new()),
                Err(error) => {
                    self.reader.restart();
                    return Err(error);
                }
            };
            // A Manager that was restarted may report the same state as before.
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

/// A mirror of the domain, and the queries that keep it up to date.
struct Reader {
    shared: Arc<SharedNode>,
    mirror: Mirror,
    /// The epoch of the Manager that the mirror shows.
    epoch: u64,
    /// The revision of the last page. Between pages, the mirror is not exact until the changes up to this
    /// revision are applied.
    revision: u64,
    /// The query for a page that is pending.
    asked: Option<Ticket>,
    /// The follower that collects changes after the mirror's revision, also while pages are read.
    follower: Option<Ticket>,
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.shared.abandon(self.asked);
        self.follow(None);
    }
}

impl Reader {
    fn new(shared: &Arc<SharedNode>) -> Self {
        Self {
            shared: Arc::clone(shared),
            mirror: Mirror::new(),
            epoch: 0,
            revision: 0,
            asked: None,
            follower: None,
        }
    }

    /// Queries the Manager until the mirror is exact.
    fn read(&mut self, until: Option<Instant>) -> Result<(), QueryError> {
        while self.mirror.ask().is_some() {
            self.step(until)?;
        }
        Ok(())
    }

    /// Makes one query: for what the mirror lacks, or for later changes if the mirror is exact. Returns the
    /// changes once the mirror is exact again.
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
        match followed? {
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
