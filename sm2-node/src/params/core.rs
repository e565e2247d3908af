//! The parameters of a node while it runs: readers take the present table without a lock, and writers replace it.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use arc_swap::ArcSwap;

use super::error::SetError;
use super::table::{Assignment, SetParameters, SetParametersResult, Table};
use super::value::ParameterType;
use crate::clock::wall_time;
use crate::{Publisher, Request};

/// The request of a client to set parameters.
pub(super) type SetRequest = Request<SetParameters, SetParametersResult>;

/// The present table, which readers load without a lock.
pub(super) type Shared = Arc<ArcSwap<Table>>;

/// A parameter of the program's node. Clones are handles of the same parameter.
///
/// [`get`](Self::get) takes no lock and never waits, so every thread can call it, also one with a deadline. Just after
/// a change, it may free the memory of the values before.
#[derive(Clone)]
pub struct Parameter<T> {
    pub(super) table: Shared,
    /// Its place in the table.
    pub(super) at: usize,
    pub(super) name: Arc<str>,
    pub(super) default: T,
}

impl<T: ParameterType> Parameter<T> {
    /// The present value. A text or a list is copied; [`Snapshot::get`] copies nothing. Until the node has declared its
    /// parameters, the value is the default.
    #[must_use]
    pub fn get(&self) -> T {
        value(&self.table.load(), self).clone()
    }

    /// The name of the parameter.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }
}

/// The value of a parameter in a table.
pub(super) fn value<'a, T: ParameterType>(table: &'a Table, parameter: &'a Parameter<T>) -> &'a T {
    let entry = table.parameters.get(parameter.at);
    let value = entry.and_then(|it| T::of_value(&it.value));
    value.unwrap_or(&parameter.default)
}

impl<T: ParameterType + fmt::Debug> fmt::Debug for Parameter<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Parameter")
            .field("name", &self.name)
            .field("value", &self.get())
            .finish()
    }
}

/// All parameters of the program's node at one moment: a set of several parameters is visible as a whole.
#[derive(Clone, Debug)]
pub struct Snapshot {
    pub(super) table: Arc<Table>,
}

impl Snapshot {
    /// The value of a parameter of this node.
    #[must_use]
    pub fn get<'a, T: ParameterType>(&'a self, parameter: &'a Parameter<T>) -> &'a T {
        value(&self.table, parameter)
    }

    /// The table, as it was published.
    #[must_use]
    pub fn table(&self) -> &Table {
        &self.table
    }
}

/// The writing side.
#[derive(Debug)]
pub(super) struct Core {
    pub(super) table: Shared,
    /// Locked while a change is made: one change at a time, in the order of their revisions.
    writer: Mutex<Publisher<Table>>,
    /// Keeps the node from having two tables.
    _claim: Arc<()>,
}

impl Core {
    pub(super) const fn new(table: Shared, publisher: Publisher<Table>, claim: Arc<()>) -> Self {
        Self {
            table,
            writer: Mutex::new(publisher),
            _claim: claim,
        }
    }

    /// Sets these values, and returns the revision of the table after it. The table is published first: a change that
    /// nobody could see is not made.
    //= SM2-PRM-002
    pub(super) fn set(&self, assignments: &[Assignment]) -> Result<u64, SetError> {
        let publisher = self.writer.lock().unwrap_or_else(PoisonError::into_inner);
        let table = self.table.load_full();
        let Some(next) = table.set(assignments, wall_time().0)? else {
            return Ok(table.revision);
        };
        publisher.publish(&next)?;
        let revision = next.revision;
        self.table.store(Arc::new(next));
        Ok(revision)
    }

    pub(super) fn snapshot(&self) -> Snapshot {
        Snapshot {
            table: self.table.load_full(),
        }
    }

    /// Sets the values of a request, and replies. Returns whether they are set: a client that has given up may have
    /// told a person that nothing was set.
    pub(super) fn accept(&self, request: SetRequest) -> bool {
        let set = match request.is_cancelled() {
            true => return false,
            false => self.set(&request.parameters),
        };
        let reply = match &set {
            Ok(revision) => SetParametersResult::granted(*revision),
            Err(error) => {
                tracing::warn!(client = %request.client(), %error, "parameters are not set");
                self.refused(error)
            }
        };
        let _ = request.reply(&reply);
        set.is_ok()
    }

    /// Replies that the values are not set.
    pub(super) fn refuse(&self, request: SetRequest, reason: &dyn fmt::Display) {
        let _ = request.reply(&self.refused(reason));
    }

    fn refused(&self, reason: &dyn fmt::Display) -> SetParametersResult {
        let revision = self.table.load().revision;
        SetParametersResult::refused(reason.to_string(), revision)
    }
}
