//! COUNTERS hands the file of a node's counters to the Manager, and INSPECT asks for such a file
//! (SM2-CNT-001, SM2-CNT-003).

use core::time::Duration;

use super::{Manager, Output, session::Session};
use crate::{
    FdFacts, Instant, NodeId, Seals, Violation,
    control::{ToNode, encode_to_node},
    counters::entries_in,
};

/// The time after which the Manager asks again for a file that it had no descriptor for.
const ASK_AGAIN: Duration = Duration::from_secs(1);

impl Manager {
    /// COUNTERS. Without `file`, the Manager's process had no free descriptor for it.
    //= SM2-CNT-001, SM2-CNT-004, SM2-TRN-011, SM2-CNT-002
    pub(super) fn keep_counters(
        &mut self,
        now: Instant,
        node: NodeId,
        file: Option<&FdFacts>,
    ) -> Result<(), Violation> {
        let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
        let Some(record) = record else {
            return Ok(());
        };
        if record.has_counters {
            return Err(violation!(CountersTwice, "SM2-CNT-001"));
        }
        let Some(file) = file else {
            self.forget_lost_counters(node);
            self.lost_counters.push_back((now.after(ASK_AGAIN), node));
            return Ok(());
        };
        if !file.regular {
            return Err(violation!(NotAMemfd, "SM2-CNT-001"));
        }
        if !file.seals.contains(Seals::POOLED) {
            return Err(violation!(SealsMissing, "SM2-CNT-001"));
        }
        entries_in(file.size_bytes).ok_or(violation!(BadSize, "SM2-CNT-001"))?;
        record.has_counters = true;
        self.outputs
            .push_back(Output::KeepCounters { session: node });
        Ok(())
    }

    /// Asks each node for its counters whose file was lost a while ago.
    //= SM2-CNT-002
    pub(super) fn ask_for_lost_counters(&mut self, now: Instant) {
        while let Some(&(at, node)) = self.lost_counters.front()
            && at <= now
        {
            self.lost_counters.pop_front();
            let record = self.sessions.get(&node).and_then(Session::node);
            if record.is_some_and(|it| !it.has_counters) {
                self.send(node, &ToNode::CountersLost);
            }
        }
    }

    pub(super) fn forget_lost_counters(&mut self, node: NodeId) {
        self.lost_counters.retain(|it| it.1 != node);
    }

    //= SM2-CNT-003, SM2-ACC-011
    pub(super) fn inspect(&mut self, node: NodeId, of: NodeId) {
        let kept = self
            .sessions
            .get(&of)
            .and_then(Session::node)
            .is_some_and(|it| it.has_counters);
        if kept && self.access.allows_inspection(node, of) {
            let frame = encode_to_node(&ToNode::Inspected { node: of });
            self.outputs.push_back(Output::SendCounters {
                session: node,
                frame,
                of,
            });
        } else {
            self.send(node, &ToNode::NotInspected { node: of });
        }
    }
}
