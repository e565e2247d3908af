//! Zenoh: peer to peer over TCP, through a router, or through its shared memory provider.
//!
//! Handlers are called on Zenoh's own threads, which its documentation recommends for low latency.
//! At one host, congestion control is `Block`: nothing is dropped, as in `rmw_zenoh` for reliable
//! topics. Over a link, there is a router at each host, and all settings are Zenoh's defaults.

use std::{
    error::Error,
    net::Ipv4Addr,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use bytes::Bytes;
use zenoh::{
    Config, Session, Wait,
    bytes::ZBytes,
    liveliness::LivelinessToken,
    pubsub::{Publisher, Subscriber},
    qos::CongestionControl,
    query::Querier,
    shm::{
        BlockOn, Defragment, GarbageCollect, PosixShmProviderBackend, ShmProvider,
        ShmProviderBuilder,
    },
};

use super::contract::{Call, Flow, Handler, Peer, PeerError, Publish, Subscribe, TIMEOUT_NS};
use crate::{
    clock::{now_ns, sleep_until},
    control::{Stage, wait_for},
    job::{Channel, Domain, Read, Recording, Side},
    link,
    payload::HEADER_BYTES,
};

mod record;

/// Timeout for connections and calls.
const TIMEOUT: Duration = Duration::from_nanos(TIMEOUT_NS);

/// The shared memory of a publisher: room for this many messages, and at least this many bytes.
const SHM_MESSAGES: usize = 4;
const SHM_BYTES: usize = 1 << 20;

type Failed = Box<dyn Error + Send + Sync>;

fn failed(action: &'static str) -> impl FnOnce(Failed) -> PeerError {
    PeerError::caused(action)
}

/// A session.
pub struct Zenoh {
    session: Session,
    shm: bool,
    /// True if publishers use Zenoh's defaults.
    plain: bool,
}

/// The settings that differ between the processes of a domain and between the Zenoh peers.
struct Setup {
    mode: &'static str,
    /// The endpoints to listen at.
    listen: Vec<String>,
    /// The endpoints to connect to.
    connect: Vec<String>,
    shm: bool,
}

impl Setup {
    fn of(domain: &Domain, first: bool) -> Self {
        let port = domain.port;
        // Later peers listen at port 0, which is any free port.
        let (mode, listen, connect) = match (domain.peer.as_str(), first) {
            ("zenoh-router", _) => ("client", None, Some(port)),
            ("zenoh-rmw", _) => ("peer", Some(0), Some(port)),
            (_, true) => ("peer", Some(port), None),
            (_, false) => ("peer", Some(0), Some(port)),
        };
        let here = |port| endpoint(Ipv4Addr::LOCALHOST, port);
        Self {
            mode,
            listen: listen.map(here).into_iter().collect(),
            connect: connect.map(here).into_iter().collect(),
            shm: matches!(domain.peer.as_str(), "zenoh-shm" | "zenoh-shm-mcap"),
        }
    }

    fn router(domain: &Domain) -> Self {
        let here = endpoint(Ipv4Addr::LOCALHOST, domain.port);
        let far = endpoint(link::address(Side::Far), domain.port);
        let (listen, connect) = match domain.side {
            None => (vec![here], Vec::new()),
            Some(Side::Near) => (vec![here], vec![far]),
            Some(Side::Far) => (vec![here, far], Vec::new()),
        };
        Self {
            mode: "router",
            listen,
            connect,
            shm: false,
        }
    }

    /// Opens a session with Zenoh's defaults, except for these settings:
    ///
    /// - no multicast, so that runs on one network do not connect to each other;
    /// - addresses of the loopback interface or of the link;
    /// - repeated attempts to connect, since the first peer may start late.
    fn open(&self) -> Result<Session, Failed> {
        // The debug format of strings is valid JSON here.
        let endpoints = |all: &[String]| format!("{all:?}");
        let mut config = Config::default();
        for (key, value) in [
            ("mode", format!("\"{}\"", self.mode)),
            ("listen/endpoints", endpoints(&self.listen)),
            ("connect/endpoints", endpoints(&self.connect)),
            ("connect/retry", "{ period_init_ms: 20 }".to_owned()),
            ("connect/timeout_ms", "10000".to_owned()),
            ("scouting/multicast/enabled", "false".to_owned()),
            ("transport/shared_memory/enabled", self.shm.to_string()),
        ] {
            config.insert_json5(key, &value)?;
        }
        zenoh::open(config).wait()
    }
}

fn endpoint(address: Ipv4Addr, port: u16) -> String {
    format!("tcp/{address}:{port}")
}

impl Peer for Zenoh {
    type Publisher = Sender;
    type Subscriber<H: Handler> = Receiver<H>;

    fn serve(domain: &Domain, ready: impl FnOnce()) -> Result<(), PeerError> {
        let _router = Setup::router(domain)
            .open()
            .map_err(failed("be the router"))?;
        ready();
        wait_for(Stage::End);
        Ok(())
    }

    fn open(domain: &Domain, _: &str, first: bool) -> Result<Self, PeerError> {
        let setup = Setup::of(domain, first);
        Ok(Self {
            session: setup.open().map_err(failed("open a session"))?,
            shm: setup.shm,
            plain: domain.side.is_some(),
        })
    }

    fn publisher(&self, channel: &Channel) -> Result<Sender, PeerError> {
        let mut builder = self.session.declare_publisher(channel.name.clone());
        if !self.plain {
            builder = builder.congestion_control(CongestionControl::Block);
            builder = builder.express(is_urgent(channel));
        }
        let publisher = builder.wait().map_err(failed("declare a publisher"))?;
        Ok(Sender {
            session: self.session.clone(),
            publisher,
            memory: self.memory(channel)?,
            tokens: format!("{}/tokens/*", channel.name),
        })
    }

    fn subscriber<H: Handler>(
        &self,
        channel: &Channel,
        handler: H,
    ) -> Result<Receiver<H>, PeerError> {
        let shared = Arc::new(Shared {
            handler: Mutex::new(handler),
            returned: Mutex::new(false),
            changed: Condvar::new(),
        });
        let called = Arc::clone(&shared);
        let subscriber = self
            .session
            .declare_subscriber(channel.name.clone())
            .callback(move |sample| called.message(sample.payload()))
            .wait()
            .map_err(failed("declare a subscriber"))?;
        // A Zenoh publisher can only ask whether it has any subscriber. Where it waits for several,
        // each subscriber declares a token after itself, and the publisher counts the tokens.
        let token = (channel.subscribers > 1).then(|| {
            let name = format!("{}/tokens/{}", channel.name, self.session.zid());
            self.session.liveliness().declare_token(name).wait()
        });
        Ok(Receiver {
            shared,
            _subscriber: subscriber,
            _token: token.transpose().map_err(failed("declare a token"))?,
        })
    }

    fn client(&self, channel: &Channel) -> Result<impl Call, PeerError> {
        let querier = self
            .session
            .declare_querier(channel.name.clone())
            .congestion_control(CongestionControl::Block)
            .express(true)
            .timeout(TIMEOUT)
            .wait()
            .map_err(failed("declare a querier"))?;
        let until_ns = now_ns() + TIMEOUT_NS;
        let there = || {
            querier
                .matching_status()
                .wait()
                .map(|status| status.matching())
        };
        while !there().map_err(failed("look for the server"))? {
            if now_ns() > until_ns {
                return Err(PeerError::new("wait for the server", "timed out"));
            }
            sleep_until(now_ns() + 1_000_000);
        }
        Ok(Caller {
            querier,
            memory: self.memory(channel)?,
        })
    }

    fn answer(
        &self,
        channel: &Channel,
        answer: impl FnMut(&[u8], &mut [u8]) + Send + 'static,
        ready: impl FnOnce(),
    ) -> Result<(), PeerError> {
        let state = Mutex::new((answer, self.memory(channel)?));
        let key = channel.name.clone();
        let _queryable = self
            .session
            .declare_queryable(channel.name.clone())
            .callback(move |query| {
                let mut state = lock(&state);
                let (answer, memory) = &mut *state;
                let request = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
                let reply = memory.message(request.len(), |reply| answer(&request, reply));
                // If the reply cannot be sent, the call of the client times out.
                if let Ok(reply) = reply {
                    let _ = query.reply(&key, reply).express(true).wait();
                }
            })
            .wait()
            .map_err(failed("declare a queryable"))?;
        ready();
        wait_for(Stage::Stop);
        Ok(())
    }

    fn record(&self, recording: &Recording, ready: impl FnOnce()) -> Result<(), PeerError> {
        record::record(self, recording, ready)
    }
}

impl Zenoh {
    fn memory(&self, channel: &Channel) -> Result<Memory, PeerError> {
        if !self.shm {
            return Ok(Memory::Heap(Pool::default()));
        }
        let bytes = (SHM_MESSAGES * channel.max_len).max(SHM_BYTES);
        let provider = ShmProviderBuilder::default_backend(bytes).wait();
        provider
            .map(|provider| Memory::Shm(Box::new(provider)))
            .map_err(|error| PeerError::new("make shared memory", error.to_string()))
    }
}

/// True if each message is sent at once, as in Zenoh's own latency benchmark. Channels with many
/// messages in flight send them in batches, as in Zenoh's throughput benchmark.
const fn is_urgent(channel: &Channel) -> bool {
    channel.depth <= 8
}

/// The memory for writing messages.
enum Memory {
    Heap(Pool),
    Shm(Box<ShmProvider<PosixShmProviderBackend>>),
}

impl Memory {
    fn message(&self, len: usize, write: impl FnOnce(&mut [u8])) -> Result<ZBytes, PeerError> {
        match self {
            Self::Heap(pool) => {
                let mut buffer = pool.take(len);
                write(&mut buffer.bytes);
                Ok(Bytes::from_owner(buffer).into())
            }
            Self::Shm(provider) => {
                let buffer = provider
                    .alloc(len)
                    .with_policy::<BlockOn<Defragment<GarbageCollect>>>()
                    .wait();
                let mut buffer = buffer.map_err(|error| {
                    PeerError::new("get memory for a message", error.to_string())
                })?;
                write(&mut buffer);
                Ok(buffer.into())
            }
        }
    }
}

/// Buffers that are used again when Zenoh has sent them. Their pages stay mapped, and Zenoh sends
/// from them without a copy.
#[derive(Clone, Default)]
struct Pool(Arc<Mutex<Vec<Vec<u8>>>>);

struct Buffer {
    bytes: Vec<u8>,
    pool: Pool,
}

impl Pool {
    fn take(&self, len: usize) -> Buffer {
        let mut bytes = lock(&self.0).pop().unwrap_or_default();
        bytes.resize(len, 0);
        Buffer {
            bytes,
            pool: self.clone(),
        }
    }
}

impl AsRef<[u8]> for Buffer {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        lock(&self.pool.0).push(std::mem::take(&mut self.bytes));
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A publisher.
pub struct Sender {
    session: Session,
    publisher: Publisher<'static>,
    memory: Memory,
    tokens: String,
}

impl Publish for Sender {
    fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> Result<(), PeerError> {
        let message = self.memory.message(len, write)?;
        self.publisher.put(message).wait().map_err(failed("put"))
    }

    fn matched(&mut self) -> Result<usize, PeerError> {
        let status = self.publisher.matching_status().wait();
        let status = status.map_err(failed("look for subscribers"))?;
        Ok(usize::from(status.matching()))
    }

    fn wait_matched(&mut self, count: usize) -> Result<(), PeerError> {
        let until_ns = now_ns() + TIMEOUT_NS;
        loop {
            let mut there = self.matched()?;
            if there > 0 && count > 1 {
                let tokens = self.session.liveliness().get(self.tokens.clone()).wait();
                there = tokens.map_err(failed("count subscribers"))?.iter().count();
            }
            if there >= count {
                return Ok(());
            }
            if now_ns() > until_ns {
                let reason = format!("{there} of {count} came");
                return Err(PeerError::new("wait for subscribers", reason));
            }
            sleep_until(now_ns() + 2_000_000);
        }
    }
}

/// A subscriber.
pub struct Receiver<H> {
    shared: Arc<Shared<H>>,
    _subscriber: Subscriber<()>,
    _token: Option<LivelinessToken>,
}

/// The handler, which Zenoh's threads call.
struct Shared<H> {
    handler: Mutex<H>,
    /// True when the handler has returned [`Flow::Return`].
    returned: Mutex<bool>,
    changed: Condvar,
}

impl<H: Handler> Shared<H> {
    fn message(&self, payload: &ZBytes) {
        let mut handler = lock(&self.handler);
        // `to_bytes` copies a fragmented message. A handler that reads only the header gets the
        // first fragment instead.
        let mut slices = payload.slices();
        let flow = match slices.next() {
            Some(first) if handler.wants() == Read::Header && first.len() >= HEADER_BYTES => {
                handler.message(first)
            }
            _ => handler.message(&payload.to_bytes()),
        };
        drop(handler);
        if flow == Flow::Return {
            *lock(&self.returned) = true;
            self.changed.notify_one();
        }
    }
}

impl<H: Handler> Subscribe<H> for Receiver<H> {
    fn pump(&mut self, until_ns: u64) -> Result<(), PeerError> {
        let mut returned = lock(&self.shared.returned);
        while !*returned {
            let left = until_ns.saturating_sub(now_ns());
            if left == 0 {
                return Ok(());
            }
            let waited = self
                .shared
                .changed
                .wait_timeout(returned, Duration::from_nanos(left));
            returned = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        *returned = false;
        Ok(())
    }

    fn with<R>(&mut self, look: impl FnOnce(&mut H) -> R) -> R {
        look(&mut lock(&self.shared.handler))
    }
}

/// A client.
struct Caller {
    querier: Querier<'static>,
    memory: Memory,
}

impl Call for Caller {
    fn call(
        &mut self,
        len: usize,
        write: impl FnOnce(&mut [u8]),
        read: impl FnOnce(&[u8]),
    ) -> Result<(), PeerError> {
        let request = self.memory.message(len, write)?;
        let replies = self.querier.get().payload(request).wait();
        let reply = replies.and_then(|replies| replies.recv());
        let reply = reply.map_err(failed("call"))?;
        let reply = reply
            .into_result()
            .map_err(|error| PeerError::new("call", error.to_string()))?;
        read(&reply.payload().to_bytes());
        Ok(())
    }
}
