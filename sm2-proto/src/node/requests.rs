//! The requests of a session that the Manager has not answered. They are forgotten with the
//! session.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::VecDeque;

use super::Misuse;
use crate::{NodeId, TypeId, Violation, schema::Schema};

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Requests {
    /// QUERYs without their page.
    queries: u64,
    /// Whether a WATCH waits for its CHANGES.
    watching: bool,
    /// Whether COUNTERS was sent.
    counters: bool,
    /// INSPECTs without their answer, oldest first.
    inspecting: VecDeque<NodeId>,
    /// DESCRIBEs without their answer, oldest first.
    describing: VecDeque<TypeId>,
    /// Whether a RELOAD waits for its RELOADED.
    reloading: bool,
}

impl Requests {
    pub(super) const fn query(&mut self) {
        self.queries += 1;
    }

    //= SM2-IFC-007
    pub(super) fn page(&mut self) -> Result<(), Violation> {
        let queries = self.queries.checked_sub(1);
        self.queries = queries.ok_or(violation!(UnexpectedPage, "SM2-IFC-007"))?;
        Ok(())
    }

    //= SM2-WCH-001
    pub(super) const fn watch(&mut self) -> Result<(), Misuse> {
        if self.watching {
            return Err(Misuse::WatchTwice);
        }
        self.watching = true;
        Ok(())
    }

    //= SM2-WCH-001
    pub(super) const fn changes(&mut self) -> Result<(), Violation> {
        if !self.watching {
            return Err(violation!(UnexpectedChanges, "SM2-WCH-001"));
        }
        self.watching = false;
        Ok(())
    }

    //= SM2-CNT-001
    pub(super) const fn counters(&mut self) -> Result<(), Misuse> {
        if self.counters {
            return Err(Misuse::CountersTwice);
        }
        self.counters = true;
        Ok(())
    }

    /// Whether COUNTERS_LOST may come.
    //= SM2-CNT-002
    pub(super) const fn counters_lost(&self) -> Result<(), Violation> {
        if !self.counters {
            return Err(violation!(UnexpectedCounters, "SM2-CNT-002"));
        }
        Ok(())
    }

    pub(super) fn inspect(&mut self, node: NodeId) {
        self.inspecting.push_back(node);
    }

    //= SM2-CNT-003
    pub(super) fn inspected(&mut self, node: NodeId) -> Result<(), Violation> {
        if self.inspecting.front() != Some(&node) {
            return Err(violation!(UnexpectedCounters, "SM2-CNT-003"));
        }
        self.inspecting.pop_front();
        Ok(())
    }

    pub(super) fn describe(&mut self, data: TypeId) {
        self.describing.push_back(data);
    }

    //= SM2-SCH-002
    pub(super) fn described(&mut self, data: &TypeId, text: Option<&str>) -> Result<(), Violation> {
        if self.describing.front() != Some(data) {
            return Err(violation!(UnexpectedSchema, "SM2-SCH-002"));
        }
        if !text.is_none_or(|text| is_text_of(text, data)) {
            return Err(violation!(BadSchema, "SM2-SCH-002"));
        }
        self.describing.pop_front();
        Ok(())
    }

    //= SM2-ACC-016
    pub(super) const fn reload(&mut self) -> Result<(), Misuse> {
        if self.reloading {
            return Err(Misuse::ReloadTwice);
        }
        self.reloading = true;
        Ok(())
    }

    //= SM2-ACC-016
    pub(super) const fn reloaded(&mut self) -> Result<(), Violation> {
        if !self.reloading {
            return Err(violation!(UnexpectedReloaded, "SM2-ACC-016"));
        }
        self.reloading = false;
        Ok(())
    }
}

/// Whether the text is a schema's and has the type's hash.
//= SM2-SCH-001
pub(super) fn is_text_of(text: &str, data: &TypeId) -> bool {
    Schema::parse(text).is_ok_and(|schema| schema.hash() == data.hash)
}
