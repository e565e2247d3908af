//! A gateway, an honest peer, and the key of a hostile peer that the gateway trusts.

use quinn_proto::TransportConfig;
use sm2_gateway::{Gateway, keys};
use sm2_io::quic::SecretKey;
use sm2_node::{Publisher, Subscriber};
use sm2_proto::{
    Name, TypeId,
    gateway::{Frame, GatewayId, Hop, OfferId, PeerFarewell, Subject},
};
use sm2_test_support::{SOON, until};
use tokio::runtime::Runtime;

use super::{client::Client, identity::honest_tls};
use crate::common::{ALL, Domain, report, runtime};

pub(crate) const EPOCH: u64 = 1 << 62;
/// The limits of the gateway for one payload, and for all payloads of a peer.
pub(crate) const MESSAGE_BYTES: usize = 100_000;
pub(crate) const MEMORY_BYTES: usize = 1_000_000;

/// Closes a connection whose HELLO comes too late.
const GREETING_TIMEOUT: u64 = PeerFarewell::GreetingTimeout.code().0 as u64;

pub(crate) struct Bench {
    pub(crate) near: Domain,
    far: Domain,
    pub(crate) key: SecretKey,
    _mallory: Domain,
    runtime: Runtime,
    pub(crate) left: Gateway,
    right: Gateway,
    publisher: Publisher<str>,
    subscriber: Subscriber<str>,
    count: u64,
    /// The last message of the honest peer.
    text: String,
}

impl Bench {
    pub(crate) fn new() -> Self {
        // A failing test shows the log of the gateways.
        #[cfg(feature = "program")]
        let _ = tracing_subscriber::fmt().with_test_writer().try_init();
        let [near, far, mallory] = ["near", "far", "mallory"].map(Domain::new);
        let runtime = runtime();
        let limits =
            format!("[limits]\nmessage_bytes = {MESSAGE_BYTES}\nmemory_bytes = {MEMORY_BYTES}\n");
        let peers = [(&far, None), (&mallory, None)];
        let left = near.gateway(&runtime, &peers, &format!("{ALL}{limits}"));
        let right = far.gateway(&runtime, &[(&near, Some(left.address()))], ALL);
        let publisher = near.node("talker").publisher::<str>("chatter").unwrap();
        let subscriber = far.node("listener").subscriber::<str>("chatter").unwrap();
        subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        let key = keys::load(&mallory.path("key")).unwrap();
        let mut bench = Self {
            near,
            far,
            key,
            _mallory: mallory,
            runtime,
            left,
            right,
            publisher,
            subscriber,
            count: 0,
            text: String::new(),
        };
        bench.is_undisturbed();
        bench
    }

    /// The honest peer receives a message.
    pub(crate) fn is_undisturbed(&mut self) {
        self.publish(0);
        let sample = self.subscriber.recv_timeout(SOON).unwrap();
        self.check(&sample.expect("in time"));
    }

    /// The honest peer receives a message, while `client` keeps its connection alive.
    pub(crate) fn is_undisturbed_beside(&mut self, client: &mut Client) {
        self.carries(0, client);
    }

    /// The honest peer receives a message of at least this length, while `client` keeps its connection alive.
    pub(crate) fn carries(&mut self, len_bytes: usize, client: &mut Client) {
        self.publish(len_bytes);
        let mut sample = None;
        client.until("the message of the honest peer", |_| {
            sample = self.subscriber.try_recv().unwrap();
            sample.is_some()
        });
        self.check(&sample.unwrap());
    }

    fn publish(&mut self, len_bytes: usize) {
        self.count += 1;
        self.text = format!("message {}{}", self.count, " ".repeat(len_bytes));
        self.publisher.publish(&self.text).unwrap();
    }

    fn check(&self, sample: &str) {
        assert_eq!(sample, self.text);
    }

    /// The names of the peers that are connected with the gateway.
    pub(crate) fn peers(&self) -> Vec<String> {
        let report = report(&self.runtime, &self.left);
        report.peers.into_iter().map(|it| it.name).collect()
    }

    /// How many messages for this peer, of this topic, were dropped for newer ones.
    pub(crate) fn superseded(&self, peer: &str, topic: &str) -> u64 {
        let peers = report(&self.runtime, &self.left).peers;
        let peer = peers.into_iter().find(|it| it.name == peer);
        let mut topics = peer.into_iter().flat_map(|it| it.subjects);
        let topic = topics.find(|it| it.name == topic);
        topic.map_or(0, |it| it.counts.superseded)
    }

    pub(crate) const fn far_id(&self) -> GatewayId {
        self.far.id
    }

    /// Connects with the trusted key.
    pub(crate) fn dial(&self) -> Client {
        self.dial_with(TransportConfig::default())
    }

    pub(crate) fn dial_with(&self, transport: TransportConfig) -> Client {
        Client::dial(self.left.address(), honest_tls(&self.key), transport).connected()
    }

    /// Connects, and exchanges greetings.
    pub(crate) fn greeted(&self) -> Client {
        self.greeted_with(TransportConfig::default, EPOCH)
    }

    /// The same, with these parameters and this epoch.
    pub(crate) fn greeted_with(
        &self,
        transport: impl Fn() -> TransportConfig,
        epoch: u64,
    ) -> Client {
        greeted(|| self.dial_with(transport()), epoch)
    }

    /// Connects, does what `act` does, and returns the code that closes the connection. If that is the end of the time
    /// for the greeting, then `act` can have come too late, and is done again.
    pub(crate) fn closed(&self, what: &str, act: impl Fn(&mut Client)) -> u64 {
        self.closed_with(TransportConfig::default, what, act)
    }

    /// The same, with these parameters.
    pub(crate) fn closed_with(
        &self,
        transport: impl Fn() -> TransportConfig,
        what: &str,
        act: impl Fn(&mut Client),
    ) -> u64 {
        let mut code = GREETING_TIMEOUT;
        until(what, || {
            let mut client = self.dial_with(transport());
            act(&mut client);
            code = client.closed(what);
            code != GREETING_TIMEOUT
        });
        code
    }

    /// Connects, and offers `subject` as offer 1. Returns when the gateway wants it.
    pub(crate) fn wanted(&self, subject: &Subject) -> Client {
        let mut client = self.greeted();
        client.frame(&offer(1, subject, self.key.id()));
        client.until("WANT", |it| {
            let mut frames = it.frames.iter();
            frames.any(|it| {
                matches!(
                    it,
                    Frame::Want {
                        offer: OfferId(1),
                        ..
                    }
                )
            })
        });
        client
    }

    pub(crate) fn stop(self) {
        let (left, right) = (self.left, self.right);
        let stop = async { tokio::join!(left.stop(), right.stop()) };
        self.runtime.block_on(stop);
    }
}

/// Connects, and exchanges greetings. On a busy machine, this thread can need longer for the greeting than the gateway
/// waits: then it connects again.
pub(crate) fn greeted(dial: impl Fn() -> Client, epoch: u64) -> Client {
    let mut greeted = None;
    until("the greeting", || {
        let mut client = dial();
        client.frame(&hello(epoch));
        client.ask();
        client.until("HELLO", |it| it.is_answered() || it.lost.is_some());
        if client.lost.is_some() {
            assert_eq!(client.closed("HELLO"), GREETING_TIMEOUT);
            return false;
        }
        greeted = Some(client);
        true
    });
    greeted.unwrap()
}

pub(crate) fn hello(epoch: u64) -> Frame {
    Frame::Hello {
        min_version: 1,
        max_version: 1,
        epoch,
        name: Name::new("mallory").unwrap(),
    }
}

pub(crate) fn offer(offer: u64, subject: &Subject, gateway: GatewayId) -> Frame {
    let epoch = EPOCH;
    Frame::Offer {
        offer: OfferId(offer),
        subject: subject.clone(),
        path: vec![Hop { gateway, epoch }],
    }
}

pub(crate) fn topic(name: &str, data: TypeId) -> Subject {
    Subject::Topic {
        name: Name::new(name).unwrap(),
        data,
        reliable: false,
        latched: 0,
    }
}
