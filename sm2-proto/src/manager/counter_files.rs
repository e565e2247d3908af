//! The files of the nodes' counters: COUNTERS hands one to the Manager, and INSPECT asks for one
//! (SM2-CNT-001, SM2-CNT-003).

use alloc::collections::{BTreeSet, VecDeque};
use core::time::Duration;

use super::{Output, outbox::Outbox};
use crate::{
    FdFacts, Instant, NodeId, Seals, Violation,
    control::{ToNode, encode_to_node},
    counters::entries_in,
};

/// The time after which the Manager asks again for a file that it had no descriptor for.
const ASK_AGAIN: Duration = Duration::from_secs(1);

/// The sessions whose files the driver keeps, and those whose files were lost.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct CounterFiles {
    kept: BTreeSet<NodeId>,
    /// When to ask for the file again. A file may have come in the meantime.
    lost: VecDeque<(Instant, NodeId)>,
}

impl CounterFiles {
    pub(super) const fn new() -> Self {
        Self {
            kept: BTreeSet::new(),
            lost: VecDeque::new(),
        }
    }

    /// COUNTERS. Without `file`, the Manager's process had no free descriptor for it.
    //= SM2-CNT-001, SM2-CNT-004, SM2-TRN-011, SM2-CNT-002
    pub(super) fn keep(
        &mut self,
        now: Instant,
        node: NodeId,
        file: Option<&FdFacts>,
        outbox: &mut Outbox,
    ) -> Result<(), Violation> {
        if self.has(node) {
            return Err(violation!(CountersTwice, "SM2-CNT-001"));
        }
        let Some(file) = file else {
            self.lost.retain(|it| it.1 != node);
            self.lost.push_back((now.after(ASK_AGAIN), node));
            return Ok(());
        };
        if !file.regular {
            return Err(violation!(NotAMemfd, "SM2-CNT-001"));
        }
        if !file.seals.contains(Seals::POOLED) {
            return Err(violation!(SealsMissing, "SM2-CNT-001"));
        }
        entries_in(file.size_bytes).ok_or(violation!(BadSize, "SM2-CNT-001"))?;
        self.kept.insert(node);
        outbox.push(Output::KeepCounters { session: node });
        Ok(())
    }

    /// Whether the driver keeps the file of a session.
    pub(super) fn has(&self, node: NodeId) -> bool {
        self.kept.contains(&node)
    }

    /// INSPECT: sends the file of a session if there is one that may be read.
    //= SM2-CNT-003, SM2-ACC-011
    pub(super) fn answer(&self, node: NodeId, of: NodeId, is_allowed: bool, outbox: &mut Outbox) {
        if is_allowed && self.has(of) {
            let frame = encode_to_node(&ToNode::Inspected { node: of });
            outbox.push(Output::SendCounters {
                session: node,
                frame,
                of,
            });
        } else {
            outbox.send(node, &ToNode::NotInspected { node: of });
        }
    }

    /// The time of the next question.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.lost.front().map(|&(at, _)| at)
    }

    /// Takes out a session that is to be asked now, because its file was lost a while ago.
    //= SM2-CNT-002
    pub(super) fn next_to_ask(&mut self, now: Instant) -> Option<NodeId> {
        while let Some(&(at, node)) = self.lost.front()
            && at <= now
        {
            self.lost.pop_front();
            if !self.has(node) {
                return Some(node);
            }
        }
        None
    }

    /// The session is over.
    pub(super) fn forget(&mut self, node: NodeId) {
        self.kept.remove(&node);
        self.lost.retain(|it| it.1 != node);
    }

    /// Whether each file belongs to a session that `is_welcomed`.
    pub(super) fn agree(&self, is_welcomed: impl Fn(NodeId) -> bool) -> bool {
        let lost = self.lost.iter().map(|&(_, node)| node);
        self.kept.iter().copied().chain(lost).all(is_welcomed)
    }
}
