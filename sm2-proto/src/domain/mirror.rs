//! A mirror of the domain becomes exact, and stays exact, by pages and changes (SM2-WCH-003).

use alloc::vec::Vec;

use super::Domain;
use crate::control::{Change, Item, Key};

/// The next request to the Manager.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Ask {
    /// QUERY; the answer goes to [`Mirror::page`].
    Page {
        /// The last item that is known.
        after: Option<Key>,
    },
    /// WATCH; the answer goes to [`Mirror::changes`].
    Changes {
        /// The revision that is known.
        after: u64,
    },
}

/// The Manager's answer breaks SPEC. The mirror has not changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum BrokenAnswer {
    /// The mirror has not asked for this answer.
    #[error("the Manager sent a page or changes that were not requested")]
    Unrequested,
    /// Items come in ascending order and after the key in the request (SM2-IFC-007).
    #[error("the Manager sent items out of their order (SM2-IFC-007)")]
    OutOfOrder,
    /// Changes lead to a later revision (SM2-WCH-001).
    #[error("the Manager sent changes that lead to no later revision (SM2-WCH-001)")]
    OldRevision,
}

/// A domain that follows its Manager.
///
/// Send the requests that [`Mirror::ask`] returns until it returns `None`: then [`Mirror::domain`]
/// is exact as of its revision. To follow the domain, ask for the changes after that revision.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Mirror {
    /// The last exact state.
    domain: Domain,
    /// The next exact state, as far as it is known.
    next: Option<Reading>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Reading {
    domain: Domain,
    step: Step,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Step {
    FirstPage,
    Pages(Key),
    Changes,
}

impl Default for Mirror {
    fn default() -> Self {
        Self::new()
    }
}

impl Mirror {
    /// A mirror that knows nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            domain: Domain::new(),
            next: Some(Reading {
                domain: Domain::new(),
                step: Step::FirstPage,
            }),
        }
    }

    /// The next request; `None` if the mirror is exact.
    #[must_use]
    pub fn ask(&self) -> Option<Ask> {
        let Reading { domain, step } = self.next.as_ref()?;
        Some(match *step {
            Step::FirstPage => Ask::Page { after: None },
            Step::Pages(key) => Ask::Page { after: Some(key) },
            Step::Changes => Ask::Changes {
                after: domain.revision,
            },
        })
    }

    /// The last exact state; empty before the first.
    #[must_use]
    pub const fn domain(&self) -> &Domain {
        &self.domain
    }

    /// The last exact state; empty before the first.
    #[must_use]
    pub fn into_domain(self) -> Domain {
        self.domain
    }

    /// There is another Manager or another session, so everything is read again. [`Mirror::domain`]
    /// keeps the last exact state until then.
    pub fn restart(&mut self) {
        self.next = Self::new().next;
    }

    /// Takes a page. Once a new state is exact, returns the changes since the last exact state.
    ///
    /// # Errors
    ///
    /// [`BrokenAnswer`]: the mirror has not changed.
    //= SM2-IFC-007, SM2-WCH-003, SM2-ACC-010
    pub fn page(
        &mut self,
        revision: u64,
        items: Vec<Item>,
        next: Option<Key>,
    ) -> Result<Vec<Change>, BrokenAnswer> {
        let reading = self.next.as_mut().ok_or(BrokenAnswer::Unrequested)?;
        let after = match reading.step {
            Step::FirstPage => None,
            Step::Pages(after) => Some(after),
            Step::Changes => return Err(BrokenAnswer::Unrequested),
        };
        let mut last = after;
        for item in &items {
            let key = Some(item.key());
            if key <= last {
                return Err(BrokenAnswer::OutOfOrder);
            }
            last = key;
        }
        // The next page starts behind this one, else the mirror would ask for the same page again and
        // again. It may start behind items that this node does not see.
        if next.is_some() && (next <= after || next < last) {
            return Err(BrokenAnswer::OutOfOrder);
        }
        if after.is_none() {
            reading.domain.revision = revision;
        }
        reading.domain.page(items);
        if let Some(key) = next {
            reading.step = Step::Pages(key);
        } else if revision == reading.domain.revision {
            return Ok(self.complete());
        } else {
            reading.step = Step::Changes;
        }
        Ok(Vec::new())
    }

    /// Takes changes: those that [`Mirror::ask`] asked for or, if the mirror is exact, those after
    /// its revision. Returns the same as [`Mirror::page`].
    ///
    /// # Errors
    ///
    /// [`BrokenAnswer`]: the mirror has not changed.
    //= SM2-WCH-002, SM2-WCH-003
    pub fn changes(
        &mut self,
        revision: u64,
        changes: Option<Vec<Change>>,
        more: bool,
    ) -> Result<Vec<Change>, BrokenAnswer> {
        let revision_known = match &self.next {
            None => self.domain.revision,
            Some(reading) if reading.step == Step::Changes => reading.domain.revision,
            Some(_) => return Err(BrokenAnswer::Unrequested),
        };
        let Some(mut changes) = changes else {
            self.restart();
            return Ok(Vec::new());
        };
        if revision <= revision_known {
            return Err(BrokenAnswer::OldRevision);
        }
        if self.next.is_none() && !more {
            // The usual case: its cost grows with the changes only.
            changes.retain(|change| self.domain.makes_a_difference(change));
            self.domain.apply(revision, changes.iter().cloned());
            return Ok(changes);
        }
        let reading = self.next.get_or_insert_with(|| Reading {
            domain: self.domain.clone(),
            step: Step::Changes,
        });
        reading.domain.apply(revision, changes);
        if more {
            return Ok(Vec::new());
        }
        Ok(self.complete())
    }

    fn complete(&mut self) -> Vec<Change> {
        let Some(Reading { domain, .. }) = self.next.take() else {
            return Vec::new();
        };
        let changes = self.domain.difference(&domain);
        self.domain = domain;
        changes
    }
}
