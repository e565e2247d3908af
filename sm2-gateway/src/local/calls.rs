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
        client: Option<Arc<AsyncClient<[u8], [u8]>>>,
        deadline: Option<Instant>,
        payload: Bytes,
        hub: HubHandle,
    ) {
        self.0.retain(|_, task| !task.is_finished());
        let task = tokio::spawn(async move {
            let (outcome, payload) = match client {
                Some(client) => call_server(&client, deadline, &payload).await,
                None => (Outcome::Unreachable, Bytes::new()),
            };
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

async fn call_server(
    client: &AsyncClient<[u8], [u8]>,
    deadline: Option<Instant>,
    payload: &[u8],
) -> (Outcome, Bytes) {
    let now = sm2_io::clock::now();
    let timeout = deadline.map_or(TIMEOUT_MAX, |it| it.since(now).min(TIMEOUT_MAX));
    let outcome = match client.call_timeout(payload, timeout).await {
        Ok(reply) => return (Outcome::Ok, Bytes::copy_from_slice(&reply)),
        Err(CallError::Failed { reason, .. }) => return (Outcome::Failed, reason.into()),
        Err(CallError::DeadlineExceeded { .. }) => Outcome::DeadlinePassed,
        Err(CallError::Cancelled { .. }) => Outcome::Cancelled,
        Err(CallError::NoServer { .. } | CallError::ServerGone { .. }) => Outcome::Unreachable,
        Err(error) => return (Outcome::Failed, error.to_string().into()),
    };
    (outcome, Bytes::new())
}
