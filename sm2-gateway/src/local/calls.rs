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

#[cfg(test)]
mod tests {
    use sm2_manager::{Background, Options};
    use sm2_node::asynchronous::IntoAsync;
    use sm2_test_support::until;

    use super::*;
    use crate::{DomainLocation, channel};

    /// And is forgotten then, at the latest when the next one starts.
    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_call_can_be_cancelled_until_it_is_over() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("sock");
        let _manager = Background::start(&socket, Options::default()).unwrap();
        let node = DomainLocation::Socket(socket).connect("both").unwrap();
        // It never replies.
        let _server = node.server::<[u8], [u8]>("slow").unwrap();
        let client = node.client::<[u8], [u8]>("slow").unwrap();
        let client = Arc::new(client.into_async().unwrap());
        let (hub, mut events) = channel::hub::channel();
        tokio::spawn(async move { while events.recv().await.is_some() {} });
        let mut calls = Calls::default();
        let start = |calls: &mut Calls, number, client| {
            let server = CalledServer {
                client,
                max_len_bytes: 100,
            };
            let call = CallId(number);
            calls.start(call, server, None, Bytes::new(), hub.clone());
        };
        let numbers = |calls: &Calls| calls.0.keys().map(|it| it.0).collect::<Vec<_>>();
        // There is no such server.
        start(&mut calls, 1, None);
        until("the answer", || calls.0[&CallId(1)].is_finished());
        start(&mut calls, 2, Some(Arc::clone(&client)));
        assert_eq!(numbers(&calls), [2]);
        start(&mut calls, 3, Some(client));
        assert_eq!(numbers(&calls), [2, 3]);
        let task = calls.0[&CallId(2)].clone();
        calls.cancel(CallId(2));
        assert_eq!(numbers(&calls), [3]);
        until("the end of the call", || task.is_finished());
    }
}
