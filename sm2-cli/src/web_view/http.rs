//! The HTTP server of the page.
//!
//! | path behind the token | content |
//! | --- | --- |
//! | the files of [`assets`](super::assets) | the page |
//! | `api/domain` | the next sample as JSON |
//! | `api/events` | each sample as a server-sent event |
//! | `api/why?one=NODE:NAME&other=NODE:NAME` | the lines of `sm2 why` as JSON; `other` may be absent |
//! | `api/schema?name=NAME` | the types of a topic or service with their schemas, as lines in JSON |
//! | `api/gateways` | a line for each gateway and peer, as JSON |
//!
//! The cost of slow or hostile clients is bounded. A client without the token can use up [`CONNECTIONS`] connections,
//! for the timeout of a head each. A stream of events holds the freshest sample only: a client that reads slowly
//! misses samples, and one that reads nothing for a timeout is disconnected ([`Timeouts`]).

use std::{
    convert::Infallible,
    io::{self, Write},
    net,
    os::unix::net::UnixStream,
    pin::Pin,
    sync::{Arc, mpsc as std_mpsc},
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use http_body_util::{Either, Full};
use hyper::{
    Method, Request, Response, StatusCode,
    body::{Body, Frame, Incoming},
    header::{ALLOW, CONTENT_TYPE, HeaderName, HeaderValue},
    server::conn::http1,
    service::service_fn,
};
use hyper_util::rt::{TokioIo, TokioTimer};
use nix::sys::socket::{setsockopt, sockopt::SndBuf};
use sm2_proto::Name;
use tokio::{
    net::{TcpListener, TcpStream},
    runtime::{self, Runtime},
    sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot, watch},
    time::timeout,
};

use super::{access::Access, assets, unread::Unread};
use crate::names::Selector;

/// Limit of concurrent connections; further ones wait to be accepted.
const CONNECTIONS: usize = 64;
/// Limit of concurrent streams of events.
const STREAMS: usize = 16;
/// Limit of questions that wait for the sampling thread.
const QUESTIONS: usize = 8;
/// Size limit of the head of a request.
const HEAD_BYTES: usize = 8 << 10;
/// Limit of the bytes that the kernel keeps for a client that does not read them. Linux doubles it.
const SEND_BUFFER_BYTES: usize = 128 << 10;
/// How long a request for a sample waits.
const SAMPLE_TIMEOUT: Duration = Duration::from_secs(10);
/// Pause after an error of `accept`, such as a lack of descriptors.
const RETRY_DELAY: Duration = Duration::from_millis(100);

/// Sent with each response: the page loads nothing from elsewhere, and no other page embeds it or learns its URL.
const HEADERS: [(&str, &str); 5] = [
    (
        "content-security-policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("referrer-policy", "no-referrer"),
    ("cache-control", "no-store"),
    ("cross-origin-resource-policy", "same-origin"),
];

/// The timeouts of the server, which tests change.
#[derive(Clone, Copy, Debug)]
pub(super) struct Timeouts {
    /// Timeout of the head of a request.
    head: Duration,
    /// How long a client may take nothing of what is sent to it.
    unread: Duration,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            head: Duration::from_secs(5),
            unread: Duration::from_secs(10),
        }
    }
}

type Content = Either<Full<Bytes>, Events>;

/// A question that the sampling thread answers.
#[derive(Debug)]
pub(super) enum Question {
    /// Why one interface is linked with another or not; without another, which ones it is linked with.
    Why {
        one: Selector,
        other: Option<Selector>,
    },
    /// The types of a topic or service, with their schemas.
    Schema(Name),
    /// The reports of the gateways.
    Gateways,
}

/// A question, and the way for its answer: lines of text, or an error as text.
#[derive(Debug)]
pub(super) struct Asked {
    pub(super) question: Question,
    pub(super) answer: oneshot::Sender<Result<Vec<String>, String>>,
}

/// The ends of a site that the sampling thread has.
#[derive(Debug)]
pub(super) struct Requests {
    /// Readable when a client or a question has come.
    pub(super) woken: UnixStream,
    pub(super) questions: std_mpsc::Receiver<Asked>,
}

/// The state that the server and the sampling thread share.
#[derive(Debug)]
pub(super) struct Site {
    access: Access,
    /// The newest sample as a server-sent event. Its receivers are the clients.
    samples: watch::Sender<Bytes>,
    streams: Arc<Semaphore>,
    questions: std_mpsc::SyncSender<Asked>,
    /// Wakes the sampling thread.
    wake: UnixStream,
}

impl Site {
    /// Creates a site, and its ends for the sampling thread.
    ///
    /// # Errors
    ///
    /// The process has no descriptors left.
    pub(super) fn new(access: Access) -> io::Result<(Arc<Self>, Requests)> {
        let (wake, woken) = UnixStream::pair()?;
        wake.set_nonblocking(true)?;
        woken.set_nonblocking(true)?;
        let (ask, questions) = std_mpsc::sync_channel(QUESTIONS);
        let site = Self {
            access,
            samples: watch::Sender::new(Bytes::new()),
            streams: Arc::new(Semaphore::new(STREAMS)),
            questions: ask,
            wake,
        };
        Ok((Arc::new(site), Requests { woken, questions }))
    }

    /// Whether a client waits for samples.
    pub(super) fn has_clients(&self) -> bool {
        self.samples.receiver_count() > 0
    }

    /// Hands a sample, a JSON object on one line, to all clients.
    pub(super) fn publish(&self, json: &[u8]) {
        let event = [EVENT_START, json, EVENT_END].concat();
        self.samples.send_replace(event.into());
    }

    /// Becomes a client, and wakes the sampling thread.
    fn subscribe(&self) -> watch::Receiver<Bytes> {
        let samples = self.samples.subscribe();
        self.wake();
        samples
    }

    fn wake(&self) {
        // If the buffer is full, the thread is about to wake.
        let _ = (&self.wake).write(&[0]);
    }

    async fn respond(self: Arc<Self>, request: Request<Incoming>) -> Response<Content> {
        let path = match self.access.check(request.headers(), request.uri()) {
            Ok(path) => path,
            Err(refused) => return text(StatusCode::FORBIDDEN, format!("{refused}\n")),
        };
        if !matches!(*request.method(), Method::GET | Method::HEAD) {
            let mut response = text(StatusCode::METHOD_NOT_ALLOWED, "use GET\n");
            let allow = HeaderValue::from_static("GET, HEAD");
            response.headers_mut().insert(ALLOW, allow);
            return response;
        }
        let query = request.uri().query().unwrap_or_default();
        match path {
            "api/domain" => self.sample().await,
            "api/events" => self.events(),
            "api/why" => self.ask_for(why(query)).await,
            "api/schema" => self.ask_for(schema(query)).await,
            "api/gateways" => self.ask(Question::Gateways).await,
            path => match assets::find(path) {
                Some(asset) => full(StatusCode::OK, asset.content_type, asset.text),
                None => text(StatusCode::NOT_FOUND, "not found\n"),
            },
        }
    }

    /// The next sample.
    async fn sample(&self) -> Response<Content> {
        let mut samples = self.subscribe();
        match timeout(SAMPLE_TIMEOUT, samples.changed()).await {
            Ok(Ok(())) => {
                let event = samples.borrow().clone();
                let json = event.slice(EVENT_START.len()..event.len() - EVENT_END.len());
                full(StatusCode::OK, JSON, json)
            }
            _ => text(
                StatusCode::SERVICE_UNAVAILABLE,
                "no sample in time: see `sm2 doctor`\n",
            ),
        }
    }

    async fn ask_for(&self, question: Result<Question, String>) -> Response<Content> {
        match question {
            Ok(question) => self.ask(question).await,
            Err(wrong) => text(StatusCode::BAD_REQUEST, wrong),
        }
    }

    async fn ask(&self, question: Question) -> Response<Content> {
        let (answer, answered) = oneshot::channel();
        if self.questions.try_send(Asked { question, answer }).is_err() {
            return text(
                StatusCode::SERVICE_UNAVAILABLE,
                "too many questions: try again\n",
            );
        }
        self.wake();
        match answered.await {
            Ok(Ok(lines)) => full(
                StatusCode::OK,
                JSON,
                serde_json::to_vec(&lines).unwrap_or_default(),
            ),
            Ok(Err(error)) => text(StatusCode::NOT_FOUND, error),
            Err(_) => text(StatusCode::SERVICE_UNAVAILABLE, "sm2 view ends\n"),
        }
    }

    /// All samples from now on.
    fn events(&self) -> Response<Content> {
        let Ok(permit) = Arc::clone(&self.streams).try_acquire_owned() else {
            return text(
                StatusCode::SERVICE_UNAVAILABLE,
                "too many pages are open: close one\n",
            );
        };
        let (sender, receiver) = mpsc::channel(1);
        tokio::spawn(forward(self.subscribe(), sender, permit));
        response(
            StatusCode::OK,
            "text/event-stream",
            Either::Right(Events(receiver)),
        )
    }
}

/// The question of a query `one=NODE:NAME&other=NODE:NAME`. Names have no characters that need an encoding.
fn why(query: &str) -> Result<Question, String> {
    let one = value(query, "one=").ok_or("name an interface: one=NODE:NAME")?;
    let other = value(query, "other=");
    Ok(Question::Why {
        one: Selector::parse(one)?,
        other: other.map(Selector::parse).transpose()?,
    })
}

/// The question of a query `name=NAME`.
fn schema(query: &str) -> Result<Question, String> {
    let name = value(query, "name=").ok_or("name a topic or service: name=NAME")?;
    let name = Name::new(name).map_err(|wrong| wrong.to_string())?;
    Ok(Question::Schema(name))
}

/// The value of a parameter of a query. `key` ends in `=`.
fn value<'a>(query: &'a str, key: &str) -> Option<&'a str> {
    query.split('&').find_map(|it| it.strip_prefix(key))
}

const EVENT_START: &[u8] = b"data: ";
const EVENT_END: &[u8] = b"\n\n";
const JSON: &str = "application/json";

/// A body of server-sent events. It ends when the site does.
#[derive(Debug)]
struct Events(mpsc::Receiver<Bytes>);

impl Body for Events {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let event = self.get_mut().0.poll_recv(context);
        event.map(|event| event.map(|it| Ok(Frame::data(it))))
    }
}

/// Hands the freshest sample to a body, each time that the body has room. Ends with the connection.
async fn forward(
    mut samples: watch::Receiver<Bytes>,
    body: mpsc::Sender<Bytes>,
    _permit: OwnedSemaphorePermit,
) {
    loop {
        let Ok(room) = body.reserve().await else {
            return;
        };
        tokio::select! {
            changed = samples.changed() => match changed {
                Ok(()) => room.send(samples.borrow_and_update().clone()),
                Err(_) => return,
            },
            () = body.closed() => return,
        }
    }
}

/// Serves a site on a thread of its own, until the runtime is shut down.
///
/// # Errors
///
/// The operating system has no thread or no descriptor.
pub(super) fn start(
    listener: net::TcpListener,
    site: Arc<Site>,
    timeouts: Timeouts,
) -> io::Result<Runtime> {
    let runtime = runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .thread_name("sm2-view")
        .enable_io()
        .enable_time()
        .build()?;
    listener.set_nonblocking(true)?;
    // Accepted sockets inherit it.
    setsockopt(&listener, SndBuf, &SEND_BUFFER_BYTES)?;
    let listener = {
        let _inside = runtime.enter();
        TcpListener::from_std(listener)?
    };
    runtime.spawn(serve(listener, site, timeouts));
    Ok(runtime)
}

async fn serve(listener: TcpListener, site: Arc<Site>, timeouts: Timeouts) {
    let permits = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let Ok(permit) = Arc::clone(&permits).acquire_owned().await else {
            return;
        };
        match listener.accept().await {
            Ok((stream, _)) => {
                let site = Arc::clone(&site);
                tokio::spawn(async move {
                    answer(stream, site, timeouts).await;
                    drop(permit);
                });
            }
            Err(error) => {
                tracing::debug!(%error, "cannot accept a connection");
                tokio::time::sleep(RETRY_DELAY).await;
            }
        }
    }
}

/// Serves one request.
async fn answer(stream: TcpStream, site: Arc<Site>, timeouts: Timeouts) {
    let stream = Unread::new(stream, timeouts.unread);
    let service = service_fn(|request| {
        let site = Arc::clone(&site);
        async move { Ok::<_, Infallible>(site.respond(request).await) }
    });
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(timeouts.head)
        .max_buf_size(HEAD_BYTES)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service)
        .await;
    if let Err(error) = served {
        tracing::debug!(%error, "a connection ended early");
    }
}

fn text(status: StatusCode, text: impl Into<Bytes>) -> Response<Content> {
    full(status, "text/plain; charset=utf-8", text)
}

fn full(
    status: StatusCode,
    content_type: &'static str,
    body: impl Into<Bytes>,
) -> Response<Content> {
    response(status, content_type, Either::Left(Full::new(body.into())))
}

fn response(status: StatusCode, content_type: &'static str, body: Content) -> Response<Content> {
    let mut response = Response::new(body);
    *response.status_mut() = status;
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(content_type));
    for (name, value) in HEADERS {
        headers.insert(
            HeaderName::from_static(name),
            HeaderValue::from_static(value),
        );
    }
    response
}

#[cfg(test)]
mod tests;
