//! The session of Zenoh, and the events of its threads.

mod inbox;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::Duration;

use bytes::Bytes;
use sm2_bridge_core::BridgeError;
use sm2_bridge_core::domain::{Service, Topic};
use sm2_gateway::hub::DEFAULT_SEND_QOS;
use sm2_io::Waker;
use sm2_node::now;
use sm2_proto::gateway::schedule::{PRIORITY_MAX, SendQos};
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, QueryTarget, Queryable};
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::session::ZenohId;
use zenoh::{Session, Wait};
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt as _, AdvancedSubscriber,
    AdvancedSubscriberBuilderExt as _, CacheConfig, HistoryConfig, MissDetectionConfig,
};

use self::inbox::Inbox;
use crate::sender::{Channel, Outcome, SendCounts, Sender};

pub(crate) use self::inbox::{Event, Message, Subject};

/// How long a call may take.
pub(crate) const CALL_MAX: Duration = Duration::from_secs(3_600);
/// How many old messages of each publisher a subscription asks for.
const HISTORY: usize = 64;
/// How long after the last message a publisher with old messages tells its number, as in rmw_zenoh.
const HEARTBEAT: Duration = Duration::from_millis(500);

/// How many requests, replies and acknowledgements wait for the network at most.
const CALLS_DEPTH: u16 = 4_096;
/// How long Zenoh waits for room in the queue of a link until it drops a message, in microseconds: at first, and in
/// addition for further fragments of a long message. Without room, it drops the following messages at once.
///
/// A client has one link. It waits long, since the bridge chooses better than Zenoh which messages to drop. A link that
/// is dead is closed only when no message waits for it any more.
///
/// A peer may have several links. A message waits for each of them in turn, and the other links wait, too.
const DROP_WAITS: [&str; 2] = ["wait_before_drop", "max_wait_before_drop_fragments"];
const CLIENT_WAITS_US: [&str; 2] = ["5000000", "10000000"];
const PEER_WAITS_US: [&str; 2] = ["250000", "500000"];

/// The session.
pub(crate) struct Network {
    /// Ends before the session does, so that it sends what waits.
    sender: Sender,
    /// The requests and replies of services, and acknowledgements.
    calls: Channel,
    session: Session,
    inbox: Inbox,
    events: Receiver<Event>,
}

/// A call of a service of the network.
pub(crate) struct Request {
    pub(crate) key: String,
    pub(crate) payload: Bytes,
    pub(crate) encoding: Encoding,
    pub(crate) attachment: Vec<u8>,
    pub(crate) target: QueryTarget,
}

/// A subscription to one topic. Ends when it is dropped.
pub(crate) enum TopicSubscriber {
    Live(#[expect(dead_code, reason = "it is only kept")] Subscriber<()>),
    WithHistory(#[expect(dead_code, reason = "it is only kept")] AdvancedSubscriber<()>),
}

impl Network {
    /// Opens a session.
    ///
    /// Its messages have `CongestionControl::Drop`, so that a router does not wait for its slow subscribers. The
    /// session itself has to wait, since only the bridge knows which messages to drop.
    pub(crate) fn open(config: &zenoh::Config) -> Result<Self, BridgeError> {
        let session = zenoh::open(with_drop_waits(config)?).wait();
        let session = session.map_err(refused("open a session"))?;
        let (inbox, events) = Inbox::new()?;
        let waker = Arc::clone(inbox.ready());
        let sender = Sender::start(move || waker.wake())?;
        let calls = sender.channel(SendQos {
            depth: CALLS_DEPTH,
            priority: PRIORITY_MAX,
            ..DEFAULT_SEND_QOS
        });
        Ok(Self {
            sender,
            calls,
            session,
            inbox,
            events,
        })
    }

    /// The number of the session.
    pub(crate) fn id(&self) -> ZenohId {
        self.session.zid()
    }

    /// Subscribes to all topics of a key expression.
    pub(crate) fn subscribe_all(&self, key: String) -> Result<Subscriber<()>, BridgeError> {
        let inbox = self.inbox.clone();
        let subscriber = self.session.declare_subscriber(key);
        let subscriber = subscriber.allowed_origin(Locality::Remote);
        let subscriber = subscriber.callback(move |sample| {
            let subject = Subject::Key(sample.key_expr().to_string());
            inbox.put_sample(subject, &sample);
        });
        (subscriber.wait()).map_err(refused("subscribe"))
    }

    /// Subscribes to a topic. With `history`, asks its publishers for the messages that they keep for late joiners.
    pub(crate) fn subscribe(
        &self,
        key: String,
        topic: Topic,
        history: bool,
    ) -> Result<TopicSubscriber, BridgeError> {
        let (inbox, topic) = (self.inbox.clone(), Arc::new(topic));
        let subscriber = self.session.declare_subscriber(key);
        let subscriber = subscriber.allowed_origin(Locality::Remote);
        let subscriber = subscriber
            .callback(move |sample| inbox.put_sample(Subject::Topic(Arc::clone(&topic)), &sample));
        let subscriber = match history {
            false => subscriber.wait().map(TopicSubscriber::Live),
            true => {
                let config = HistoryConfig::default().detect_late_publishers();
                let subscriber = subscriber.history(config.max_samples(HISTORY));
                subscriber.wait().map(TopicSubscriber::WithHistory)
            }
        };
        subscriber.map_err(refused("subscribe"))
    }

    /// Declares a publisher of a topic, which has [changed](Self::take_changed) when its subscribers come or go. It
    /// keeps the last `latched` messages for late joiners.
    pub(crate) fn publisher(
        &self,
        key: String,
        encoding: Encoding,
        topic: &Topic,
        latched: u16,
    ) -> Result<AdvancedPublisher<'static>, BridgeError> {
        let publisher = self.session.declare_publisher(key).encoding(encoding);
        let publisher = publisher
            // A subscriber of this session may match every key.
            .allowed_destination(Locality::Remote)
            // A slow network must not stop the bridge: it drops messages.
            .congestion_control(CongestionControl::Drop)
            .advanced();
        let publisher = match latched {
            0 => publisher,
            _ => publisher
                .publisher_detection()
                .cache(CacheConfig::default().max_samples(latched.into()))
                .sample_miss_detection(
                    MissDetectionConfig::default().sporadic_heartbeat(HEARTBEAT),
                ),
        };
        let publisher = publisher.wait();
        let publisher = publisher.map_err(refused("declare a publisher"))?;
        let (inbox, topic) = (self.inbox.clone(), topic.clone());
        let listener = publisher
            .matching_listener()
            .callback(move |_| inbox.note_change(topic.clone()))
            .background()
            .wait();
        listener.map_err(refused("follow the subscribers"))?;
        Ok(publisher)
    }

    /// Offers a service of the domain.
    pub(crate) fn serve(
        &self,
        key: String,
        service: Service,
    ) -> Result<Queryable<()>, BridgeError> {
        let (inbox, service) = (self.inbox.clone(), Arc::new(service));
        let queryable = self.session.declare_queryable(key).complete(true);
        let queryable = queryable.allowed_origin(Locality::Remote);
        let queryable =
            queryable.callback(move |query| inbox.put(Event::Query(Arc::clone(&service), query)));
        (queryable.wait()).map_err(refused("offer a service"))
    }

    /// Calls a service of the network. The reply comes with [`next_reply`](Self::next_reply) and this number.
    pub(crate) fn call(&self, request: Request, number: u64) {
        let answer = self.inbox.answer(number);
        let (session, len) = (self.session.clone(), request.payload.len());
        let call = move || {
            let call = session.get(&request.key).payload(request.payload);
            let call = call
                .encoding(request.encoding)
                .attachment(request.attachment)
                .target(request.target)
                .consolidation(ConsolidationMode::None)
                .allowed_destination(Locality::Remote)
                .timeout(CALL_MAX)
                .callback(move |reply| {
                    let payload = reply.result().ok().map(|it| it.payload().clone());
                    if payload.is_some() {
                        answer.give(payload);
                    }
                });
            outcome(&request.key, call.wait())
        };
        self.calls.put(len, now(), Box::new(call));
    }

    /// Does something for a service as soon as the network takes it: `len` bytes.
    pub(crate) fn reply(&self, len: usize, task: impl FnOnce() -> Outcome + Send + 'static) {
        self.calls.put(len, now(), Box::new(task));
    }

    /// A channel for messages of a topic, which are sent in this way.
    pub(crate) fn channel(&self, qos: SendQos) -> Channel {
        self.sender.channel(qos)
    }

    /// Puts a message of a durable topic into the network, by a channel.
    pub(crate) fn put(
        &self,
        channel: &Channel,
        key: String,
        encoding: Encoding,
        payload: Bytes,
        attachment: Vec<u8>,
    ) {
        let len = payload.len();
        let put = self.put_task(key, encoding, payload, attachment);
        channel.put(len, now(), Box::new(put));
    }

    /// Acknowledges a message of a durable topic. Without it the message comes again, and is acknowledged then.
    pub(crate) fn acknowledge(&self, key: String, payload: Bytes, attachment: Vec<u8>) {
        let len = payload.len();
        let put = self.put_task(key, Encoding::ZENOH_STRING, payload, attachment);
        let put = move || match put() {
            Outcome::Sent => Outcome::Uncounted,
            other => other,
        };
        self.calls.put(len, now(), Box::new(put));
    }

    fn put_task(
        &self,
        key: String,
        encoding: Encoding,
        payload: Bytes,
        attachment: Vec<u8>,
    ) -> impl FnOnce() -> Outcome + Send + 'static {
        let session = self.session.clone();
        move || {
            let put = session.put(&key, payload).encoding(encoding);
            let put = put
                .attachment(attachment)
                .congestion_control(CongestionControl::Drop)
                .allowed_destination(Locality::Remote);
            outcome(&key, put.wait())
        }
    }

    /// Declares a liveliness token.
    pub(crate) fn declare_token<K>(&self, key: K) -> Result<LivelinessToken, BridgeError>
    where
        K: TryInto<KeyExpr<'static>>,
        K::Error: Into<zenoh::Error>,
    {
        let token = self.session.liveliness().declare_token(key).wait();
        token.map_err(refused("declare a token"))
    }

    /// Follows the liveliness tokens of a key expression for the time of the session.
    pub(crate) fn follow_tokens(&self, key: String) -> Result<(), BridgeError> {
        let inbox = self.inbox.clone();
        let note = move |sample: Sample| {
            let is_alive = sample.kind() == SampleKind::Put;
            let key = sample.key_expr().as_str();
            inbox.note_token(key, is_alive);
        };
        let listener = self.session.liveliness().declare_subscriber(key);
        let listener = listener.history(true).callback(note).background().wait();
        listener.map_err(refused("follow the endpoints"))
    }

    /// The tokens that are alive, if they have changed since the last call.
    pub(crate) fn take_tokens(&self) -> Option<BTreeSet<String>> {
        self.inbox.take_tokens()
    }

    /// A descriptor that is readable when there may be a message or a change.
    pub(crate) const fn ready(&self) -> &Arc<Waker> {
        self.inbox.ready()
    }

    /// Lets the descriptor wait for what comes later than this call.
    pub(crate) fn clear_ready(&self) {
        self.inbox.clear_ready();
    }

    /// Makes the descriptor readable: there may be more.
    pub(crate) fn wake(&self) {
        self.inbox.wake();
    }

    /// The next message or call.
    pub(crate) fn next(&self) -> Option<Event> {
        self.inbox.take(&self.events)
    }

    /// The next reply to a call of the domain: the number of the call, and the payload. `None` stands for no reply.
    pub(crate) fn next_reply(&self) -> Option<(u64, Option<ZBytes>)> {
        self.inbox.take_reply()
    }

    /// The topics whose first subscriber has come, or whose last one has left.
    pub(crate) fn take_changed(&self) -> BTreeSet<Topic> {
        self.inbox.take_changed()
    }

    /// Reads the counts of the messages that were to be sent, and how many messages and calls came while too many
    /// others waited.
    pub(crate) fn counts(&self) -> impl Fn() -> (SendCounts, u64) + Send + Sync + 'static {
        let (sent, inbox) = (self.sender.counts(), self.inbox.clone());
        move || (sent(), inbox.dropped())
    }
}

/// The configuration with the times after which the session drops a message.
fn with_drop_waits(config: &zenoh::Config) -> Result<zenoh::Config, BridgeError> {
    let mut config = config.clone();
    let is_client = config.get_json("mode").is_ok_and(|it| it == "\"client\"");
    let waits = match is_client {
        true => CLIENT_WAITS_US,
        false => PEER_WAITS_US,
    };
    for (name, wait) in DROP_WAITS.iter().zip(waits) {
        let set = config.insert_json5(&drop_wait_key(name), wait);
        set.map_err(|error| refused("configure the session")(error.to_string().into()))?;
    }
    Ok(config)
}

/// The key of a time in Zenoh's configuration.
fn drop_wait_key(name: &str) -> String {
    format!("transport/link/tx/queue/congestion_control/drop/{name}")
}

/// The end of a message that was given to Zenoh.
pub(crate) fn outcome(key: &str, result: zenoh::Result<()>) -> Outcome {
    match result {
        Ok(()) => Outcome::Sent,
        Err(error) => {
            tracing::warn!(key, %error, "Zenoh refuses a message");
            Outcome::Refused
        }
    }
}

/// Zenoh refuses an attempt of the bridge.
pub(crate) fn refused(action: &'static str) -> impl FnOnce(zenoh::Error) -> BridgeError {
    move |error| BridgeError::Network {
        action,
        error: error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_waits_less_than_a_second_for_a_link() {
        let waits_us = |mode: Option<&str>| {
            let mut config = zenoh::Config::default();
            if let Some(mode) = mode {
                config.insert_json5("mode", mode).unwrap();
            }
            let config = with_drop_waits(&config).unwrap();
            let wait = |name| config.get_json(&drop_wait_key(name)).unwrap();
            let waits = DROP_WAITS.map(|it| wait(it).parse::<u64>().unwrap());
            waits.iter().sum::<u64>()
        };
        assert_eq!(waits_us(Some("\"client\"")), 15_000_000);
        // Without a mode, a session is a peer.
        for mode in [Some("\"peer\""), None] {
            assert!(waits_us(mode) < 1_000_000);
        }
    }
}
