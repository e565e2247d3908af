//! Requests of the domain's clients to servers that stand for remote ones.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use bytes::Bytes;
use sm2_node::{
    Node, RecvError, Request, Server,
    asynchronous::{AsyncServer, IntoAsync},
};
use sm2_proto::{
    Name, TypeId,
    gateway::{GatewayId, Outcome, Subject},
};
use tokio::sync::oneshot;

use super::{calls::too_long, error::LocalError};
use crate::{
    channel::hub::{HubEvent, HubHandle},
    hub::{LocalEvent, RequestId},
    retry::until_ok,
};

/// Interval of the checks for cancelled requests and free request slots.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// The requests without a reply.
#[derive(Debug, Default)]
pub(super) struct Requests {
    last: RequestId,
    open: BTreeMap<RequestId, oneshot::Sender<(Outcome, Bytes)>>,
}

impl Requests {
    fn open(&mut self) -> (RequestId, oneshot::Receiver<(Outcome, Bytes)>) {
        let (answer, answered) = oneshot::channel();
        self.last.0 += 1;
        self.open.insert(self.last, answer);
        (self.last, answered)
    }
}

pub(super) fn server(
    node: &Node,
    name: &Name,
    [request, reply]: [&TypeId; 2],
    max_len_bytes: u64,
) -> Result<AsyncServer<[u8], [u8]>, LocalError> {
    let server: Server<[u8], [u8]> = node
        .server_builder(name.as_str())
        .type_ids(request.clone(), reply.clone())
        .max_borrowed(256)
        .max_len(max_len_bytes)
        .declare()?;
    Ok(server.into_async()?)
}

/// The path of requests from one server to the hub, and of the replies back.
#[derive(Clone)]
pub(super) struct Forward {
    pub(super) subject: Subject,
    pub(super) origin: GatewayId,
    /// The greatest length of a request.
    pub(super) max_len_bytes: u64,
    pub(super) requests: Arc<Mutex<Requests>>,
    pub(super) hub: HubHandle,
}

/// Forwards each request to the hub, until the task is aborted.
pub(super) async fn serve(server: AsyncServer<[u8], [u8]>, forward: Forward) {
    let subject = &forward.subject;
    loop {
        let server = &server;
        let receive = || async move {
            loop {
                match server.recv().await {
                    // `max_borrowed` requests are in flight: retries until one has its reply.
                    Err(RecvError::TooManyBorrowed { .. }) => {
                        tokio::time::sleep(POLL_INTERVAL).await
                    }
                    received => break received,
                }
            }
        };
        let report = |error: &RecvError| {
            tracing::warn!(name = %subject.name(), %error, "cannot take a request");
        };
        let request = until_ok(receive, report).await;
        if request.len() as u64 > forward.max_len_bytes {
            let reason = too_long("request", forward.max_len_bytes);
            // Fails only if the caller has gone.
            let _ = request.fail(&reason);
        } else {
            drop(tokio::spawn(forward.clone().request(request)));
        }
    }
}

impl Forward {
    async fn request(self, request: Request<[u8], [u8]>) {
        let Self {
            subject,
            origin,
            requests,
            hub,
            ..
        } = self;
        let (id, mut answered) = lock(&requests).open();
        let event = LocalEvent::Request {
            request: id,
            subject,
            origin,
            deadline: request.deadline(),
            payload: Bytes::copy_from_slice(&request),
        };
        let _ = hub.send(HubEvent::Local(event)).await;
        let answer = loop {
            tokio::select! {
                answer = &mut answered => break answer.ok(),
                () = tokio::time::sleep(POLL_INTERVAL) => if request.is_cancelled() {
                    lock(&requests).open.remove(&id);
                    let event = LocalEvent::Dropped { request: id };
                    let _ = hub.send(HubEvent::Local(event)).await;
                    return;
                },
            }
        };
        let done = match answer {
            Some((Outcome::Ok, payload)) => request.reply(&payload),
            Some((Outcome::Failed, reason)) => request.fail(&String::from_utf8_lossy(&reason)),
            Some((Outcome::Denied, _)) => request.fail("denied by the rules of a gateway"),
            Some((Outcome::DeadlinePassed, _)) => request.fail("the deadline passed at a gateway"),
            Some((Outcome::Cancelled, _)) => request.fail("cancelled at a gateway"),
            Some((Outcome::Unreachable, _)) | None => {
                request.fail("unreachable: a gateway has no route to the server")
            }
        };
        if let Err(error) = done {
            tracing::debug!(%error, "the caller did not wait for its reply");
        }
    }
}

pub(super) fn answer(
    requests: &Arc<Mutex<Requests>>,
    request: RequestId,
    outcome: Outcome,
    payload: Bytes,
) {
    if let Some(caller) = lock(requests).open.remove(&request) {
        // The receiver is gone if the caller has cancelled.
        let _ = caller.send((outcome, payload));
    }
}

fn lock(requests: &Mutex<Requests>) -> std::sync::MutexGuard<'_, Requests> {
    requests.lock().unwrap_or_else(PoisonError::into_inner)
}
