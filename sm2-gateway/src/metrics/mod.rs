//! What a gateway counts, for Prometheus: `GET /metrics` over HTTP, in the OpenMetrics text format.
//!
//! | metric | labels | |
//! | --- | --- | --- |
//! | `sm2_gateway_peer_connected` | `peer` | 1 or 0, for each peer that is trusted |
//! | `sm2_gateway_peer_rtt_seconds` | `peer` | the time that it takes there and back |
//! | `sm2_gateway_peer_denied` | `peer` | how many names the rules deny now |
//! | `sm2_gateway_peer_COUNT_total` | `peer` | of all messages, requests and replies |
//! | `sm2_gateway_COUNT_total` | `peer`, `kind`, `name` | of those of a topic or a service |
//!
//! `COUNT` is each field of [`Counts`](crate::Counts). All of them are of the current connection: they
//! start again with the next one, as Prometheus expects of counters. A name that nothing was counted of
//! is left out, so that no peer can fill a database by offering names.
//!
//! There is no TLS, and whoever connects may read: the names of topics among other things. So listen at
//! a loopback address. A scraper that is slow or hostile harms nothing: there are 8
//! connections at a time with 5 s each, of the hub no more is asked than 10 times in a second, and what is
//! sent to all of them is in memory once.

mod text;

use std::{
    convert::Infallible,
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use http_body_util::Full;
use hyper::{
    Method, Request, Response, StatusCode,
    body::Incoming,
    header::{ALLOW, CONTENT_TYPE, HeaderValue},
    server::conn::http1,
    service::service_fn,
};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::{
    net::{TcpListener, TcpStream},
    sync::{Mutex, Semaphore},
    time::timeout,
};

use crate::channel::hub::HubHandle;

/// How many connections there are at a time: others wait to be accepted.
const CONNECTIONS: usize = 8;
/// How long one may take, from its first byte to the last one of the answer.
const LONGEST: Duration = Duration::from_secs(5);
/// How long its request may take.
const REQUEST: Duration = Duration::from_secs(2);
/// The longest head of a request.
const HEAD_BYTES: usize = 8 << 10;
/// How long the gateway may take to say how it is.
const PATIENCE: Duration = Duration::from_secs(2);
/// An answer is given again for so long.
const FRESH: Duration = Duration::from_millis(100);
/// How long to wait where the system has no descriptors.
const PAUSE: Duration = Duration::from_millis(100);

const OPEN_METRICS: HeaderValue =
    HeaderValue::from_static("application/openmetrics-text; version=1.0.0; charset=utf-8");

/// What all connections share.
#[derive(Debug)]
struct Source {
    hub: HubHandle,
    /// The last answer, and when it was made.
    last: Mutex<Option<(Instant, Bytes)>>,
}

/// Answers for as long as there is a hub.
pub(crate) async fn serve(listener: TcpListener, hub: HubHandle) {
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    let source = Arc::new(Source {
        hub: hub.clone(),
        last: Mutex::default(),
    });
    loop {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else {
            return;
        };
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = hub.closed() => return,
        };
        match accepted {
            Ok((stream, _)) => {
                let source = Arc::clone(&source);
                tokio::spawn(async move {
                    // One that takes longer has its answer, or needs none.
                    let _ = timeout(LONGEST, answer(stream, source)).await;
                    drop(place);
                });
            }
            Err(error) => {
                tracing::debug!(%error, "a connection for metrics was not accepted");
                tokio::time::sleep(PAUSE).await;
            }
        }
    }
}

/// One connection: one request, and its answer.
async fn answer(stream: TcpStream, source: Arc<Source>) {
    let service = service_fn(|request| {
        let source = Arc::clone(&source);
        async move { Ok::<_, Infallible>(source.respond(&request).await) }
    });
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(REQUEST)
        .max_buf_size(HEAD_BYTES)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service)
        .await;
    if let Err(error) = served {
        tracing::debug!(%error, "a connection for metrics ended early");
    }
}

impl Source {
    async fn respond(&self, request: &Request<Incoming>) -> Response<Full<Bytes>> {
        if request.uri().path() != "/metrics" {
            return plain(StatusCode::NOT_FOUND, "there is only /metrics\n");
        }
        if !matches!(*request.method(), Method::GET | Method::HEAD) {
            let mut response = plain(StatusCode::METHOD_NOT_ALLOWED, "GET it\n");
            let allow = HeaderValue::from_static("GET, HEAD");
            response.headers_mut().insert(ALLOW, allow);
            return response;
        }
        match self.text().await {
            Some(text) => {
                let mut response = Response::new(Full::new(text));
                response.headers_mut().insert(CONTENT_TYPE, OPEN_METRICS);
                response
            }
            None => plain(
                StatusCode::SERVICE_UNAVAILABLE,
                "the gateway did not answer in time\n",
            ),
        }
    }

    /// Whoever comes while it is made waits for it, and has the same.
    async fn text(&self) -> Option<Bytes> {
        let mut last = self.last.lock().await;
        if let Some((at, text)) = &*last
            && at.elapsed() < FRESH
        {
            return Some(text.clone());
        }
        let report = timeout(PATIENCE, self.hub.report()).await.ok()?.ok()?;
        let text = Bytes::from(text::text(&report).ok()?);
        *last = Some((Instant::now(), text.clone()));
        Some(text)
    }
}

fn plain(status: StatusCode, text: &'static str) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::new(Bytes::from_static(text.as_bytes())));
    *response.status_mut() = status;
    response
}
