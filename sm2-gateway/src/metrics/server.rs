//! The HTTP server of metrics.

use std::{
    convert::Infallible,
    pin::Pin,
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

/// Limit of concurrent connections; further ones wait to be accepted.
const CONNECTIONS: usize = 8;
/// Size limit of the head of a request.
const HEAD_BYTES: usize = 8 << 10;
/// How long a text is reused.
const CACHE_TIME: Duration = Duration::from_millis(100);
/// Pause after an error of `accept`, such as a lack of descriptors.
const RETRY_DELAY: Duration = Duration::from_millis(100);

const OPEN_METRICS: HeaderValue =
    HeaderValue::from_static("application/openmetrics-text; version=1.0.0; charset=utf-8");

/// The timeouts of the server, which tests change.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct Timeouts {
    /// Timeout of a connection.
    pub connection: Duration,
    /// Timeout of the head of a request.
    pub head: Duration,
    /// Timeout of a report.
    pub report: Duration,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            connection: Duration::from_secs(5),
            head: Duration::from_secs(2),
            report: Duration::from_secs(2),
        }
    }
}

/// Makes the text of the metrics; `None` if it cannot be had.
pub(super) type Make = Box<dyn Fn() -> Made + Send + Sync>;
/// The text to come.
pub(super) type Made = Pin<Box<dyn Future<Output = Option<String>> + Send>>;

/// State that all connections share.
struct Source {
    make: Make,
    timeouts: Timeouts,
    /// The last text and its time.
    last: Mutex<Option<(Instant, Bytes)>>,
}

/// Accepts connections until the task is dropped.
pub(super) async fn serve(listener: TcpListener, make: Make, timeouts: Timeouts) {
    let permits = Arc::new(Semaphore::new(CONNECTIONS));
    let source = Arc::new(Source {
        make,
        timeouts,
        last: Mutex::default(),
    });
    loop {
        let Ok(permit) = Arc::clone(&permits).acquire_owned().await else {
            return;
        };
        match listener.accept().await {
            Ok((stream, _)) => {
                let source = Arc::clone(&source);
                tokio::spawn(async move {
                    // A connection that exceeds the timeout is closed.
                    let _ = timeout(timeouts.connection, answer(stream, source)).await;
                    drop(permit);
                });
            }
            Err(error) => {
                tracing::debug!(%error, "cannot accept a connection for metrics");
                tokio::time::sleep(RETRY_DELAY).await;
            }
        }
    }
}

/// Serves one request.
async fn answer(stream: TcpStream, source: Arc<Source>) {
    let head = source.timeouts.head;
    let service = service_fn(|request| {
        let source = Arc::clone(&source);
        async move { Ok::<_, Infallible>(source.respond(&request).await) }
    });
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(head)
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
            return plain(
                StatusCode::NOT_FOUND,
                "not found: the only path is /metrics\n",
            );
        }
        if !matches!(*request.method(), Method::GET | Method::HEAD) {
            let mut response = plain(StatusCode::METHOD_NOT_ALLOWED, "use GET\n");
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
            None => plain(StatusCode::SERVICE_UNAVAILABLE, "no report in time\n"),
        }
    }

    /// The metrics as text. Concurrent requests wait for the same text.
    async fn text(&self) -> Option<Bytes> {
        let mut last = self.last.lock().await;
        if let Some((at, text)) = &*last
            && at.elapsed() < CACHE_TIME
        {
            return Some(text.clone());
        }
        let text = timeout(self.timeouts.report, (self.make)()).await.ok()?;
        let text = Bytes::from(text?);
        *last = Some((Instant::now(), text.clone()));
        Some(text)
    }
}

fn plain(status: StatusCode, text: &'static str) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::new(Bytes::from_static(text.as_bytes())));
    *response.status_mut() = status;
    response
}
