//! QUIC without any middleware: each message is a stream of its own. When the stream has been
//! acknowledged completely, the next one opens with the newest message. There is one subscriber, at
//! the far host.

use std::{
    fs,
    net::{Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{Receiver as Queue, RecvTimeoutError, SyncSender, sync_channel},
    },
    time::Duration,
};

use quinn::{
    ClientConfig, Connection, Endpoint, Incoming, ServerConfig, TransportConfig,
    congestion::BbrConfig,
    rustls::{
        RootCertStore,
        pki_types::{CertificateDer, PrivatePkcs8KeyDer},
    },
};
use tokio::{runtime::Runtime, sync::Notify, time};

use super::contract::{Flow, Handler, Peer, PeerError, Publish, Subscribe};
use crate::{
    clock::now_ns,
    job::{Channel, Domain, Side},
    link,
};

/// The name in the subscriber's certificate.
const NAME: &str = "far";

/// Timeout of one attempt to connect. The publisher tries again, since the subscriber may come later.
const ATTEMPT: Duration = Duration::from_millis(500);

/// The address and certificate that lead the publisher to its subscriber.
pub struct Quinn {
    certificate: PathBuf,
    address: SocketAddr,
    bbr: bool,
}

fn failed<E: std::fmt::Display>(action: &'static str) -> impl FnOnce(E) -> PeerError {
    PeerError::caused(action)
}

impl Peer for Quinn {
    type Publisher = Sender;
    type Subscriber<H: Handler> = Receiver<H>;

    fn open(domain: &Domain, _: &str, _: bool) -> Result<Self, PeerError> {
        Ok(Self {
            certificate: domain.dir.join("quinn.der"),
            address: (link::address(Side::Far), domain.port).into(),
            bbr: domain.peer == "raw-quinn-bbr",
        })
    }

    fn publisher(&self, _: &Channel) -> Result<Sender, PeerError> {
        let runtime = Runtime::new().map_err(failed("start threads"))?;
        let entered = runtime.enter();
        let any = (Ipv4Addr::UNSPECIFIED, 0).into();
        let endpoint = Endpoint::client(any).map_err(failed("open a socket"))?;
        let freshest = Arc::new(Freshest::default());
        runtime.spawn(send(
            endpoint,
            self.certificate.clone(),
            self.address,
            self.bbr,
            Arc::clone(&freshest),
        ));
        drop(entered);
        Ok(Sender {
            freshest,
            _runtime: runtime,
        })
    }

    fn subscriber<H: Handler>(
        &self,
        channel: &Channel,
        handler: H,
    ) -> Result<Receiver<H>, PeerError> {
        let runtime = Runtime::new().map_err(failed("start threads"))?;
        let made = rcgen::generate_simple_self_signed([NAME.to_owned()]);
        let made = made.map_err(failed("make a certificate"))?;
        let certificate = made.cert.der().clone();
        let key = PrivatePkcs8KeyDer::from(made.signing_key.serialize_der());
        let config = ServerConfig::with_single_cert(vec![certificate.clone()], key.into());
        let config = config.map_err(failed("use a certificate"))?;
        let any = (Ipv4Addr::UNSPECIFIED, self.address.port()).into();
        let entered = runtime.enter();
        let endpoint = Endpoint::server(config, any).map_err(failed("listen"))?;
        drop(entered);
        // A queue of one message, so that a slow handler slows the sender.
        let (messages, queue) = sync_channel(1);
        runtime.spawn(receive(endpoint, channel.max_len, messages));
        publish_certificate(&self.certificate, &certificate).map_err(failed("write a file"))?;
        Ok(Receiver {
            queue,
            handler,
            _runtime: runtime,
        })
    }
}

/// Writes the file in one step, so that the publisher never reads a part of it.
fn publish_certificate(path: &Path, certificate: &[u8]) -> std::io::Result<()> {
    let part = path.with_extension("part");
    fs::write(&part, certificate)?;
    fs::rename(part, path)
}

/// The newest message, which is sent next.
#[derive(Default)]
struct Freshest {
    message: Mutex<Option<Vec<u8>>>,
    came: Notify,
}

impl Freshest {
    fn swap(&self, message: Option<Vec<u8>>) -> Option<Vec<u8>> {
        let mut current = self.message.lock().unwrap_or_else(PoisonError::into_inner);
        std::mem::replace(&mut current, message)
    }

    async fn take(&self) -> Vec<u8> {
        loop {
            if let Some(message) = self.swap(None) {
                return message;
            }
            self.came.notified().await;
        }
    }
}

/// Connects and sends; connects again when the connection ends.
async fn send(
    endpoint: Endpoint,
    certificate: PathBuf,
    address: SocketAddr,
    bbr: bool,
    freshest: Arc<Freshest>,
) {
    loop {
        let attempt = connect(&endpoint, &certificate, address, bbr);
        match time::timeout(ATTEMPT, attempt).await {
            Ok(Some(connection)) => {
                // An error ends this connection; the loop makes the next one.
                let _ = send_over(&connection, &freshest).await;
            }
            Ok(None) => time::sleep(ATTEMPT / 10).await,
            Err(_) => {}
        }
    }
}

async fn connect(
    endpoint: &Endpoint,
    certificate: &Path,
    address: SocketAddr,
    bbr: bool,
) -> Option<Connection> {
    let mut roots = RootCertStore::empty();
    let certificate = CertificateDer::from(fs::read(certificate).ok()?);
    roots.add(certificate).ok()?;
    let mut config = ClientConfig::with_root_certificates(Arc::new(roots)).ok()?;
    if bbr {
        let mut transport = TransportConfig::default();
        transport.congestion_controller_factory(Arc::new(BbrConfig::default()));
        config.transport_config(Arc::new(transport));
    }
    let connecting = endpoint.connect_with(config, address, NAME).ok()?;
    connecting.await.ok()
}

async fn send_over(
    connection: &Connection,
    freshest: &Freshest,
) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    loop {
        let message = freshest.take().await;
        let mut stream = connection.open_uni().await?;
        stream.write_all(&message).await?;
        stream.finish()?;
        // Returns when the subscriber has acknowledged the whole stream.
        stream.stopped().await?;
    }
}

/// Accepts connections until the endpoint closes.
async fn receive(endpoint: Endpoint, max_len: usize, messages: SyncSender<Vec<u8>>) {
    while let Some(incoming) = endpoint.accept().await {
        // A publisher whose connection fails connects again.
        tokio::spawn(receive_from(incoming, max_len, messages.clone()));
    }
}

async fn receive_from(
    incoming: Incoming,
    max_len: usize,
    messages: SyncSender<Vec<u8>>,
) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let connection = incoming.await?;
    loop {
        let mut stream = connection.accept_uni().await?;
        let message = stream.read_to_end(max_len).await?;
        messages.send(message)?;
    }
}

/// A publisher.
pub struct Sender {
    freshest: Arc<Freshest>,
    _runtime: Runtime,
}

impl Publish for Sender {
    fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> Result<(), PeerError> {
        // The buffer of a message that was not sent is used again.
        let mut message = self.freshest.swap(None).unwrap_or_default();
        message.resize(len, 0);
        write(&mut message);
        self.freshest.swap(Some(message));
        self.freshest.came.notify_one();
        Ok(())
    }

    /// This peer does not count its subscribers.
    fn matched(&mut self) -> Result<usize, PeerError> {
        Ok(0)
    }
}

/// A subscriber.
pub struct Receiver<H> {
    queue: Queue<Vec<u8>>,
    handler: H,
    _runtime: Runtime,
}

impl<H: Handler> Subscribe<H> for Receiver<H> {
    fn pump(&mut self, until_ns: u64) -> Result<(), PeerError> {
        loop {
            let left = Duration::from_nanos(until_ns.saturating_sub(now_ns()));
            match self.queue.recv_timeout(left) {
                Ok(message) if self.handler.message(&message) == Flow::Return => return Ok(()),
                Ok(_) => {}
                Err(RecvTimeoutError::Timeout) => return Ok(()),
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(PeerError::new("receive", "the socket is gone"));
                }
            }
        }
    }

    fn with<R>(&mut self, look: impl FnOnce(&mut H) -> R) -> R {
        look(&mut self.handler)
    }
}
