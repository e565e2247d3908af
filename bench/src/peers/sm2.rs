//! SM2: one Manager, and a node in each process. Short messages are copied; longer ones are written
//! into loans. Over a link, each host has a Manager and a [gateway], and topics are keep-last (the
//! default).

use std::{fmt::Display, path::PathBuf, time::Duration};

use sm2_manager::{Manager, Options};
use sm2_node::{Client, Instant, Node, Publisher, Subscriber, Wait};

use super::contract::{
    Call, Flow, Handler, Peer, PeerError, Publish, Subscribe, TIMEOUT_NS, one_by_one,
};
use crate::{
    clock::now_ns,
    control::{Stage, reached},
    job::{Channel, Domain, Recording},
};

mod gateway;
mod record;

/// Timeout for connections, calls and reliable messages.
const TIMEOUT: Duration = Duration::from_nanos(TIMEOUT_NS);

/// How often a server checks whether to stop.
const LOOK: Duration = Duration::from_millis(250);

/// A node.
pub struct Sm2 {
    node: Node,
    mode: Mode,
}

/// The peer that records SM2's topics with the crate `mcap`.
const MCAP: &str = "mcap-writer";

/// The longest message that is copied, in bytes: copying it is faster than taking a loan.
const SHORT: usize = 1_024;

/// The most messages that `sm2-batch` takes in one call.
const BATCH: usize = 64;

/// The differences between `sm2`, `sm2-drop`, `sm2-sealed`, `sm2-spin` and `sm2-batch`. To add a
/// configuration of SM2, add a field here, its use below, and a peer in the catalogue.
#[derive(Clone, Copy)]
struct Mode {
    reliable: bool,
    sealed: bool,
    wait: Wait,
    batch: bool,
    recorder: Recorder,
}

/// The program that records.
#[derive(Clone, Copy)]
enum Recorder {
    /// The recorder of `sm2-bag`.
    Bag,
    /// A program with the crate `mcap`.
    Mcap,
}

impl Mode {
    fn of(domain: &Domain) -> Self {
        let peer = domain.peer.as_str();
        Self {
            reliable: peer != "sm2-drop" && domain.side.is_none(),
            sealed: peer == "sm2-sealed",
            wait: if peer == "sm2-spin" {
                Wait::Spin
            } else {
                Wait::Park
            },
            batch: peer == "sm2-batch",
            recorder: match peer {
                MCAP => Recorder::Mcap,
                _ => Recorder::Bag,
            },
        }
    }
}

/// The path of the Manager's socket.
pub(super) fn socket(domain: &Domain) -> PathBuf {
    match domain.side {
        None => domain.dir.join("sm2.sock"),
        Some(side) => domain.dir.join(format!("sm2-{}.sock", side.as_str())),
    }
}

fn failed<E: Display>(action: &'static str) -> impl FnOnce(E) -> PeerError {
    PeerError::caused(action)
}

impl Peer for Sm2 {
    type Publisher = Sender;
    type Subscriber<H: Handler> = Receiver<H>;

    /// Runs the Manager that the program `sm2-manager` runs.
    fn serve(domain: &Domain, ready: impl FnOnce()) -> Result<(), PeerError> {
        if let Some(side) = domain.side {
            return gateway::serve(domain, side, &socket(domain), ready);
        }
        let manager =
            Manager::bind(&socket(domain), Options::default()).map_err(failed("be Manager"))?;
        ready();
        manager.run().map(drop).map_err(failed("be Manager"))
    }

    fn open(domain: &Domain, name: &str, _: bool) -> Result<Self, PeerError> {
        let node = Node::builder(name).socket(socket(domain)).connect();
        Ok(Self {
            node: node.map_err(failed("connect a node"))?,
            mode: Mode::of(domain),
        })
    }

    fn publisher(&self, channel: &Channel) -> Result<Sender, PeerError> {
        let builder = self.node.publisher_builder::<[u8]>(&channel.name);
        let mut builder = builder.depth(depth(channel)).sealed(self.mode.sealed);
        if self.mode.reliable {
            builder = builder.reliable(true).publish_timeout(TIMEOUT);
        }
        let publisher = builder.declare().map_err(failed("declare a publisher"))?;
        Ok(Sender {
            publisher,
            batch: self.mode.batch,
            messages: Vec::new(),
        })
    }

    fn subscriber<H: Handler>(
        &self,
        channel: &Channel,
        handler: H,
    ) -> Result<Receiver<H>, PeerError> {
        let builder = self.node.subscriber_builder::<[u8]>(&channel.name);
        let builder = builder
            .depth(depth(channel))
            .max_borrowed(if self.mode.batch { BATCH as u16 } else { 1 })
            .reliable(self.mode.reliable)
            .wait(self.mode.wait);
        let subscriber = builder.declare().map_err(failed("declare a subscriber"))?;
        Ok(Receiver {
            subscriber,
            handler,
            batch: self.mode.batch,
        })
    }

    fn client(&self, channel: &Channel) -> Result<impl Call, PeerError> {
        let builder = self.node.client_builder::<[u8], [u8]>(&channel.name);
        let client = builder
            .sealed(self.mode.sealed)
            .wait(self.mode.wait)
            .declare()
            .map_err(failed("declare a client"))?;
        client
            .wait_for_servers_timeout(1, TIMEOUT)
            .map_err(failed("wait for the server"))?;
        Ok(Caller {
            client,
            request: vec![0; channel.max_len],
        })
    }

    fn answer(
        &self,
        channel: &Channel,
        mut answer: impl FnMut(&[u8], &mut [u8]) + Send + 'static,
        ready: impl FnOnce(),
    ) -> Result<(), PeerError> {
        let builder = self.node.server_builder::<[u8], [u8]>(&channel.name);
        let server = builder
            .sealed(self.mode.sealed)
            .wait(self.mode.wait)
            .declare()
            .map_err(failed("declare a server"))?;
        ready();
        let mut reply = vec![0; channel.max_len];
        while !reached(Stage::Stop) {
            let request = server.recv_timeout(LOOK).map_err(failed("serve"))?;
            let Some(request) = request else { continue };
            let reply = &mut reply[..request.len()];
            answer(&request, reply);
            request.reply(reply).map_err(failed("reply"))?;
        }
        Ok(())
    }

    fn record(&self, recording: &Recording, ready: impl FnOnce()) -> Result<(), PeerError> {
        match self.mode.recorder {
            Recorder::Mcap => record::mcap(&self.node, recording, ready),
            Recorder::Bag => record::bag(&self.node, recording, ready),
        }
    }
}

fn depth(channel: &Channel) -> u16 {
    channel.depth.clamp(1, 1_024) as u16
}

/// A publisher.
pub struct Sender {
    publisher: Publisher<[u8]>,
    batch: bool,
    /// The buffer of short messages.
    messages: Vec<u8>,
}

impl Publish for Sender {
    fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> Result<(), PeerError> {
        if len <= SHORT {
            self.messages.resize(len, 0);
            write(&mut self.messages);
            let published = self.publisher.publish(&self.messages);
            let published = published.map_err(failed("publish"))?;
            published.complete().map_err(failed("publish"))?;
            return Ok(());
        }
        let loan = self.publisher.loan_slice(len);
        let mut loan = loan.map_err(failed("get memory for a message"))?;
        write(&mut loan);
        let published = loan.publish().map_err(failed("publish"))?;
        published.complete().map_err(failed("publish"))?;
        Ok(())
    }

    fn publish_run(
        &mut self,
        count: usize,
        len: usize,
        mut write: impl FnMut(&mut [u8]),
    ) -> Result<(), PeerError> {
        if !self.batch {
            return one_by_one(self, count, len, write);
        }
        self.messages.resize(count * len, 0);
        self.messages.chunks_exact_mut(len).for_each(&mut write);
        let published = self.publisher.publish_all(self.messages.chunks_exact(len));
        let published = published.map_err(failed("publish"))?;
        published.complete().map_err(failed("publish"))?;
        Ok(())
    }

    fn matched(&mut self) -> Result<usize, PeerError> {
        Ok(self.publisher.links().len())
    }

    fn wait_matched(&mut self, count: usize) -> Result<(), PeerError> {
        self.publisher
            .wait_for_subscribers_timeout(count, TIMEOUT)
            .map_err(failed("wait for subscribers"))
    }

    fn flush(&mut self) -> Result<(), PeerError> {
        match self.publisher.flush_timeout(TIMEOUT) {
            Ok(true) => Ok(()),
            Ok(false) => Err(PeerError::new("flush", "a subscriber takes no messages")),
            Err(error) => Err(failed("flush")(error)),
        }
    }
}

/// A subscriber.
pub struct Receiver<H> {
    subscriber: Subscriber<[u8]>,
    handler: H,
    batch: bool,
}

impl<H: Handler> Receiver<H> {
    /// Takes up to `BATCH` messages per call.
    fn pump_batches(&mut self, timeout: Duration) -> Result<(), PeerError> {
        let handler = &mut self.handler;
        let (mut flow, mut failure) = (Flow::Continue, None);
        while flow == Flow::Continue && failure.is_none() {
            let seen = (self.subscriber).recv_each_timeout(BATCH, timeout, |sample| match sample {
                Ok(sample) if handler.message(sample) == Flow::Return => flow = Flow::Return,
                Ok(_) => {}
                Err(error) => failure = Some(error),
            });
            if seen.map_err(failed("receive"))? == 0 {
                break;
            }
        }
        failure.map_or(Ok(()), |error| Err(failed("read a message")(error)))
    }
}

impl<H: Handler> Subscribe<H> for Receiver<H> {
    fn pump(&mut self, until_ns: u64) -> Result<(), PeerError> {
        // One reading of the clock per call: at millions of messages per second, one reading per
        // message would show in the figures.
        let timeout = Instant(until_ns).since(Instant(now_ns()));
        if self.batch {
            return self.pump_batches(timeout);
        }
        loop {
            let sample = self.subscriber.recv_timeout(timeout);
            match sample.map_err(failed("receive"))? {
                Some(sample) => {
                    if self.handler.message(&sample) == Flow::Return {
                        return Ok(());
                    }
                }
                None => return Ok(()),
            }
        }
    }

    fn with<R>(&mut self, look: impl FnOnce(&mut H) -> R) -> R {
        look(&mut self.handler)
    }
}

/// A client.
struct Caller {
    client: Client<[u8], [u8]>,
    request: Vec<u8>,
}

impl Call for Caller {
    fn call(
        &mut self,
        len: usize,
        write: impl FnOnce(&mut [u8]),
        read: impl FnOnce(&[u8]),
    ) -> Result<(), PeerError> {
        let request = &mut self.request[..len];
        write(request);
        let reply = self.client.call_timeout(request, TIMEOUT);
        read(&reply.map_err(failed("call"))?);
        Ok(())
    }
}
