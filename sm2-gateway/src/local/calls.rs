//! Calls of the domain's servers on behalf of peers.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use bytes::Bytes;
use sm2_node::{CallError, asynchronous::AsyncClient};
use sm2_proto::{Instant, gateway::Outcome};
use tokio::task::AbortHandle;

use crate::{
    channel::hub::{HubEvent, HubHandle},
    hub::LocalEvent,
    peer::CallId,
};

/// Upper bound of a call without a deadline, so that a peer cannot accumulate calls here.
const TIMEOUT_MAX: Duration = Duration::from_secs(600);

/// The tasks of the calls without a reply.
#[derive(Debug, Default)]
pub(super) struct Calls(BTreeMap<CallId, AbortHandle>);

impl Calls {
    pub(super) fn start(
        &mut self,
        call: CallId,
        server: CalledServer,
        deadline: Option<Instant>,
        payload: Bytes,
        hub: HubHandle,
    ) {
        self.0.retain(|_, task| !task.is_finished());
        let task = tokio::spawn(async move {
            let (outcome, payload) = server.call(deadline, &payload).await;
            let event = LocalEvent::Replied {
                call,
                outcome,
                payload,
            };
            let _ = hub.send(HubEvent::Local(event)).await;
        });
        self.0.insert(call, task.abort_handle());
    }

    pub(super) fn cancel(&mut self, call: CallId) {
        if let Some(task) = self.0.remove(&call) {
            task.abort();
        }
    }
}

/// A server of the domain.
pub(super) struct CalledServer {
    /// Its client; `None` if there is no such server.
    pub(super) client: Option<Arc<AsyncClient<[u8], [u8]>>>,
    /// The greatest length of its reply.
    pub(super) max_len_bytes: u64,
}

impl CalledServer {
    async fn call(&self, deadline: Option<Instant>, payload: &[u8]) -> (Outcome, Bytes) {
        let Some(client) = &self.client else {
            return (Outcome::Unreachable, Bytes::new());
        };
        let now = sm2_io::clock::now();
        let timeout = deadline.map_or(TIMEOUT_MAX, |it| it.since(now).min(TIMEOUT_MAX));
        let outcome = match client.call_timeout(payload, timeout).await {
            Ok(reply) if reply.len() as u64 > self.max_len_bytes => {
                return (
                    Outcome::Failed,
                    too_long("reply", self.max_len_bytes).into(),
                );
            }
            Ok(reply) => return (Outcome::Ok, Bytes::copy_from_slice(&reply)),
            Err(CallError::Failed { reason, .. }) => return (Outcome::Failed, reason.into()),
            Err(CallError::DeadlineExceeded { .. }) => Outcome::DeadlinePassed,
            Err(CallError::Cancelled { .. }) => Outcome::Cancelled,
            Err(CallError::NoServer { .. } | CallError::ServerGone { .. }) => Outcome::Unreachable,
            Err(error) => return (Outcome::Failed, error.to_string().into()),
        };
        (outcome, Bytes::new())
    }
}

/// The reason of the failure of a call whose `what`, a request or a reply, is too long.
pub(super) fn too_long(what: &str, max_len_bytes: u64) -> String {
    format!("the {what} is longer than `message_bytes` of the gateway, {max_len_bytes} bytes")
}
