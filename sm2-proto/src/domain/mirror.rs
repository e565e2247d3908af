//! How a mirror comes to be exact, and stays so (SM2-WCH-003).

use alloc::vec::Vec;

use super::Domain;
use crate::control::{Change, Item, Key};

/// What to ask the Manager.
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

/// What no Manager says that obeys SPEC. The mirror is as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Nonsense {
    /// Nobody asked for it.
    #[error("the Manager sent a page or changes that the mirror did not ask for")]
    Unasked,
    /// Items come in ascending order and after what was asked (SM2-IFC-007).
    #[error("the Manager sent items out of their order (SM2-IFC-007)")]
    Order,
    /// Changes lead to a later revision (SM2-WCH-001).
    #[error("the Manager sent changes that lead nowhere (SM2-WCH-001)")]
    Revision,
}

/// A domain that follows its Manager.
///
/// Ask what [`Mirror::ask`] says until it says nothing: then [`Mirror::domain`] is exact as of
/// its revision. To follow it, ask for the changes after that revision.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Mirror {
    /// The last exact state.
    domain: Domain,
    /// The next one, as far as it is known.
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

    /// What to ask now; nothing if the mirror is exact.
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

    /// There is another Manager, or another session: everything is read anew.
    /// [`Mirror::domain`] stays what it is until then.
    pub fn restart(&mut self) {
        self.next = Self::new().next;
    }

    /// Takes a page. Gives what has changed since the last exact state as soon as
    /// there is a new one, and nothing before.
    ///
    /// # Errors
    ///
    /// [`Nonsense`]: the mirror is as it was.
    //= SM2-IFC-007, SM2-WCH-003
    pub fn page(
        &mut self,
        revision: u64,
        items: Vec<Item>,
        next: Option<Key>,
    ) -> Result<Vec<Change>, Nonsense> {
        let reading = self.next.as_mut().ok_or(Nonsense::Unasked)?;
        let after = match reading.step {
            Step::FirstPage => None,
            Step::Pages(after) => Some(after),
            Step::Changes => return Err(Nonsense::Unasked),
        };
        let mut last = after;
        for item in &items {
            let key = Some(item.key());
            if key <= last {
                return Err(Nonsense::Order);
            }
            last = key;
        }
        // A page that others follow holds something, else it would be asked for again and again.
        if next.is_some() && (items.is_empty() || next != last) {
            return Err(Nonsense::Order);
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

    /// Takes changes: those that [`Mirror::ask`] asked for, or, of an exact mirror, those
    /// after its revision. Gives what [`Mirror::page`] gives.
    ///
    /// # Errors
    ///
    /// [`Nonsense`]: the mirror is as it was.
    //= SM2-WCH-002, SM2-WCH-003
    pub fn changes(
        &mut self,
        revision: u64,
        changes: Option<Vec<Change>>,
        more: bool,
    ) -> Result<Vec<Change>, Nonsense> {
        let revision_known = match &self.next {
            None => self.domain.revision,
            Some(reading) if reading.step == Step::Changes => reading.domain.revision,
            Some(_) => return Err(Nonsense::Unasked),
        };
        let Some(mut changes) = changes else {
            self.restart();
            return Ok(Vec::new());
        };
        if revision <= revision_known {
            return Err(Nonsense::Revision);
        }
        if self.next.is_none() && !more {
            // The way of every day: its cost is that of the changes.
            changes.retain(|change| self.domain.is_news(change));
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
