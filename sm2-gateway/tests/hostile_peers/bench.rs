//! A gateway, an honest peer, and the key of a hostile peer that the gateway trusts.

use quinn_proto::TransportConfig;
use sm2_gateway::{Gateway, keys};
use sm2_io::quic::SecretKey;
use sm2_node::{Publisher, Subscriber};
use sm2_proto::{
    Name, TypeId,
    gateway::{Frame, GatewayId, Hop, OfferId, Subject},
};
use tokio::runtime::Runtime;

use super::{client::Client, identity::honest_tls};
use crate::common::{ALL, Domain, SOON, report, runtime};

pub(crate) const EPOCH: u64 = 1 << 62;
/// The limits of the gateway for one payload, and for all payloads of a peer.
pub(crate) const MESSAGE_BYTES: usize = 100_000;
pub(crate) const MEMORY_BYTES: usize = 1_000_000;

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
}

impl Bench {
    pub(crate) fn new() -> Self {
        // A failing test shows the log of the gateways.
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
        };
        bench.is_undisturbed();
        bench
    }

    /// The honest peer receives a message.
    pub(crate) fn is_undisturbed(&mut self) {
        self.carries(0);
    }

    /// The honest peer receives a message of at least this length.
    pub(crate) fn carries(&mut self, len_bytes: usize) {
        self.count += 1;
        let text = format!("message {}{}", self.count, " ".repeat(len_bytes));
        self.publisher.publish(&text).unwrap();
        let sample = self.subscriber.recv_timeout(SOON).unwrap();
        assert_eq!(&*sample.expect("in time"), text.as_str());
    }

    /// The names of the peers that are connected with the gateway.
    pub(crate) fn peers(&self) -> Vec<String> {
        let report = report(&self.runtime, &self.left);
        report.peers.into_iter().map(|it| it.name).collect()
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
        let mut client = self.dial();
        client.frame(&hello(EPOCH));
        client.until("HELLO", |it| !it.frames.is_empty());
        client
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
