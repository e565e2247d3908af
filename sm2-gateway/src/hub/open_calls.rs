//! The calls without a reply.

use std::collections::BTreeMap;

use sm2_proto::gateway::Subject;

use super::domain::RequestId;
use crate::peer::{CallId, ConnectionId, PeerCall};

/// The calls without a reply, by number.
#[derive(Debug, Default)]
pub(super) struct OpenCalls {
    open: BTreeMap<CallId, OpenCall>,
    last: CallId,
}

/// A call without a reply.
#[derive(Clone, Debug)]
pub(super) struct OpenCall {
    pub(super) caller: Caller,
    /// The service.
    pub(super) subject: Subject,
    /// The connection that carries the request; `None` if it went to a server of the domain.
    pub(super) sent_by: Option<ConnectionId>,
}

/// The party that waits for the reply to a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Caller {
    Local {
        request: RequestId,
    },
    Peer {
        connection: ConnectionId,
        call: PeerCall,
    },
}

impl OpenCalls {
    pub(super) fn len(&self) -> usize {
        self.open.len()
    }

    pub(super) fn add(
        &mut self,
        caller: Caller,
        subject: Subject,
        sent_by: Option<ConnectionId>,
    ) -> CallId {
        self.last.0 += 1;
        let call = OpenCall {
            caller,
            subject,
            sent_by,
        };
        self.open.insert(self.last, call);
        self.last
    }

    pub(super) fn remove(&mut self, call: CallId) -> Option<OpenCall> {
        self.open.remove(&call)
    }

    /// Removes all calls that `is_it` accepts.
    pub(super) fn remove_all(
        &mut self,
        is_it: impl Fn(&OpenCall) -> bool,
    ) -> BTreeMap<CallId, OpenCall> {
        let mut removed = BTreeMap::new();
        self.open.retain(|call, it| {
            let is_removed = is_it(it);
            if is_removed {
                removed.insert(*call, it.clone());
            }
            !is_removed
        });
        removed
    }
}
