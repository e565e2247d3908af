//! The tasks of an executor, and waiting for the next one.
//!
//! One thread waits at a time. It takes the message before another thread may wait, so no two threads find the same
//! message. A ready source of a busy group is taken out of the wait set until the group's turn comes back; otherwise, a
//! level-triggered set would report it again and again.

use std::collections::{HashMap, VecDeque};
use std::fmt;
use std::io;
use std::sync::Arc;

use super::callback::ExecutorError;
use super::id::CallbackId;
use super::mailbox::{Letters, Mailbox};
use super::runs::Duties;
use super::task::Task;
use super::turn::Due;
use crate::WaitSet;
use crate::driver::WaitFailure;
use crate::wait_set::{Cause, Interest, Key};

/// A task, which several threads share.
pub(super) type SharedTask<'a> = Arc<dyn Task + 'a>;

/// The tasks of an executor. One thread at a time has them, and waits for the next one.
pub(super) struct Tasks<'a> {
    /// The mailbox has no tag.
    pub(super) set: WaitSet<'a, Option<CallbackId>>,
    all: HashMap<CallbackId, (Vec<Key>, SharedTask<'a>)>,
    /// Callbacks that have waited for the turn of their group. They come before all others.
    due: VecDeque<Due>,
    mailbox: Arc<Mailbox<Addition<'a>>>,
    /// The interfaces of all callbacks.
    pub(super) duties: Arc<Duties>,
}

/// The reason why there is no further callback.
pub(super) enum End {
    Shutdown,
    Error(ExecutorError),
}

/// Adds a source and its callback.
pub(super) struct Addition<'a>(Box<Add<'a>>);

type Add<'a> = dyn FnOnce(&mut Tasks<'a>) -> Result<(), ExecutorError> + Send + 'a;

impl<'a> Addition<'a> {
    pub(super) fn new(
        add: impl FnOnce(&mut Tasks<'a>) -> Result<(), ExecutorError> + Send + 'a,
    ) -> Self {
        Self(Box::new(add))
    }
}

impl<'a> Tasks<'a> {
    pub(super) fn new(
        mailbox: &Arc<Mailbox<Addition<'a>>>,
        duties: &Arc<Duties>,
    ) -> io::Result<Self> {
        let mut set = WaitSet::new()?;
        set.add_descriptor(Arc::clone(mailbox), Interest::Readable, None)?;
        Ok(Self {
            set,
            all: HashMap::new(),
            due: VecDeque::new(),
            mailbox: Arc::clone(mailbox),
            duties: Arc::clone(duties),
        })
    }

    pub(super) fn insert(&mut self, id: CallbackId, keys: Vec<Key>, task: SharedTask<'a>) {
        self.all.insert(id, (keys, task));
    }

    /// Waits for the next callback that can run. The turn of its group is taken, and so is its item. `None` if all
    /// threads have to end.
    pub(super) fn next(&mut self) -> Result<Option<SharedTask<'a>>, End> {
        while !self.mailbox.is_over() {
            let Some(due) = self.next_due()? else {
                continue;
            };
            // It may have been removed meanwhile.
            let Some((_, task)) = self.all.get(&due.id) else {
                continue;
            };
            let task = Arc::clone(task);
            if !task.turn().take_or_wait(due) {
                // Otherwise the source would be reported again and again.
                self.set.suspend(due.key);
                continue;
            }
            // The wait set may report a source before the mailbox. A callback that removed this one left the letter
            // before it gave back the turn.
            if self.mailbox.has_removals() {
                self.read_mail()?;
                if !self.all.contains_key(&due.id) {
                    self.resume(task.turn().give_back())?;
                    continue;
                }
            }
            // The callback may have run in another thread since the source was reported: then it may have read all.
            let cause = self.set.confirm(due.key, due.cause)?;
            if !self.set.contains(due.key) {
                // A call, or a timer that does not repeat: this was all.
                self.forget(due.id);
            }
            if cause.is_some_and(|cause| task.take(cause)) {
                return Ok(Some(task));
            }
            self.resume(task.turn().give_back())?;
        }
        Ok(None)
    }

    /// The next callback that is due. `None` if there was mail instead.
    fn next_due(&mut self) -> Result<Option<Due>, End> {
        if let Some(due) = self.due.pop_front() {
            return Ok(Some(due));
        }
        let ready = self.set.wait_or_fail()?;
        let Some(id) = ready.tag else {
            self.read_mail()?;
            return Ok(None);
        };
        let (key, cause) = (ready.key, ready.cause);
        Ok(Some(Due { id, key, cause }))
    }

    fn read_mail(&mut self) -> Result<(), End> {
        let Letters {
            additions,
            removals,
            resumed,
            ..
        } = self.mailbox.take();
        for Addition(add) in additions {
            add(self)?;
        }
        for id in removals {
            for key in self.forget(id) {
                self.set.remove(key);
            }
        }
        Ok(self.resume(resumed)?)
    }

    /// Drops a callback. Returns the keys of its source.
    fn forget(&mut self, id: CallbackId) -> Vec<Key> {
        self.duties.remove(id);
        self.all.remove(&id).map_or_else(Vec::new, |(keys, _)| keys)
    }

    /// The turn of their group is free again.
    fn resume(&mut self, resumed: Vec<Due>) -> io::Result<()> {
        for due in resumed {
            self.set.resume(due.key)?;
            // A descriptor may have been ready only because the callback had not read from it yet.
            if !matches!(due.cause, Cause::Descriptor(_)) {
                self.due.push_back(due);
            }
        }
        Ok(())
    }
}

impl From<WaitFailure> for End {
    fn from(failure: WaitFailure) -> Self {
        match failure {
            WaitFailure::Shutdown => Self::Shutdown,
            WaitFailure::Io(error) => error.into(),
        }
    }
}

impl From<io::Error> for End {
    fn from(error: io::Error) -> Self {
        Self::Error(ExecutorError::Io(error))
    }
}

impl From<ExecutorError> for End {
    fn from(error: ExecutorError) -> Self {
        Self::Error(error)
    }
}

impl fmt::Debug for Tasks<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Tasks")
            .field("set", &self.set)
            .field("due", &self.due)
            .finish_non_exhaustive()
    }
}
