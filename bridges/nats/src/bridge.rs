//! The bridge: one thread, which waits for the domain, its topics and the stream at the same time.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;
use sm2_bridge_core::domain::{Topic, published};
use sm2_bridge_core::{
    Account, BridgeError, Counts, Durable, Ended, Inbound, Member, Origin, Origins, Outbox,
    Payload, ReadAccount, Shadow, Verdict,
};
use sm2_gateway::is_remote;
use sm2_node::clock::wall_time;
use sm2_node::domain::Watch;
use sm2_node::wait_set::{Interest, Key};
use sm2_node::{Node, Shutdown, Subscriber, WaitError, WaitSet, now};
use sm2_proto::gateway::{Direction, SubjectKind};

use crate::config::Config;
use crate::message::Message;
use crate::stream::{Event, Receipt, Stream};

/// How many messages of each publisher wait for the bridge.
const DEPTH: u16 = 64;
/// How many messages of a topic are taken at once, so that no topic delays the others.
const BURST: usize = 64;

/// The thing that is ready.
#[derive(Clone, Debug)]
enum Ready {
    Domain,
    Stream,
    Topic(Arc<Topic>),
}

/// A topic of the domain that goes to the stream.
struct Outgoing {
    subscriber: Subscriber<[u8]>,
    key: Key,
    /// That of the last message.
    origin: Origin,
}

/// A bridge between a domain and a stream.
///
/// Dropping it ends it.
pub struct Bridge {
    config: Config,
    /// The node that subscribes.
    node: Node,
    watch: Watch,
    set: WaitSet<'static, Ready>,
    stream: Stream,
    outbox: Outbox,
    outgoing: BTreeMap<Topic, Outgoing>,
    inbound: Inbound<Delivered>,
    origins: Origins,
    counts: Counts,
    /// The account as other threads see it.
    account: Arc<Mutex<Account>>,
    /// Rules that are only compared.
    shadow: Option<Shadow>,
}

impl Bridge {
    /// Joins the domain, and connects to the stream in the background.
    ///
    /// # Errors
    ///
    /// See [`BridgeError`].
    pub fn start(config: &Config) -> Result<Self, BridgeError> {
        let Member {
            node,
            remote,
            mut watch,
        } = Member::join(&config.domain, &config.name)?;
        let spool = &config.spool;
        let outbox = Outbox::open(&spool.folder, spool.limits.clone(), now(), wall_time().0)
            .map_err(BridgeError::Spool)?;
        let stream = Stream::open(config)?;
        let mut set = WaitSet::new()?;
        set.add_watch(&mut watch, Ready::Domain)?;
        set.add_descriptor(
            Arc::clone(stream.ready()),
            Interest::Readable,
            Ready::Stream,
        )?;
        let account = Account {
            bridge: config.name.clone(),
            network: "nats",
            counts: Counts::default(),
            spool: Some(outbox.counts()),
        };
        Ok(Self {
            config: config.clone(),
            node,
            watch,
            set,
            stream,
            outbox,
            outgoing: BTreeMap::new(),
            inbound: Inbound::new(remote),
            origins: Origins::new(config.name.clone()),
            counts: Counts::default(),
            account: Arc::new(Mutex::new(account)),
            shadow: None,
        })
    }

    /// The messages since the start.
    #[must_use]
    pub fn account(&self) -> ReadAccount {
        let account = Arc::clone(&self.account);
        Arc::new(move || {
            account
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .clone()
        })
    }

    /// Compares with other rules from now on, and logs each difference.
    pub fn set_shadow(&mut self, shadow: Shadow) {
        self.shadow = Some(shadow);
    }

    /// Carries messages until `shutdown` is requested.
    ///
    /// # Errors
    ///
    /// See [`BridgeError`].
    pub fn run(&mut self, shutdown: &Shutdown) -> Result<(), BridgeError> {
        self.follow_domain()?;
        self.set.end_with(shutdown)?;
        loop {
            match self.wait() {
                Ok(None) => {}
                Ok(Some(Ready::Domain)) => self.follow_domain()?,
                Ok(Some(Ready::Stream)) => self.follow_stream()?,
                Ok(Some(Ready::Topic(topic))) => self.forward(&topic),
                Err(WaitError::Shutdown) => {
                    let ended = self.inbound.take_all();
                    self.note(ended);
                    self.report();
                    return Ok(());
                }
                Err(error) => return Err(BridgeError::Wait(error)),
            }
            let ended = self.inbound.take_ended();
            self.note(ended);
            self.send();
            self.report();
        }
    }

    /// Shows the account to other threads, and logs what other rules would change.
    fn report(&mut self) {
        let mut account = self.account.lock().unwrap_or_else(PoisonError::into_inner);
        (account.counts, account.spool) = (self.counts, Some(self.outbox.counts()));
        drop(account);
        if let Some(shadow) = &mut self.shadow {
            for line in shadow.compare(&self.config.rules) {
                tracing::info!("shadow: {line}");
            }
        }
    }

    /// The next thing that is ready. `None` if the outbox has something to send before, or messages of the stream may
    /// wait no longer.
    fn wait(&mut self) -> Result<Option<Ready>, WaitError> {
        let outbox = self.outbox.deadline().map(|it| it.since(now()));
        let timeout = [outbox, self.inbound.timeout()].into_iter().flatten().min();
        let ready = match timeout {
            Some(timeout) => self.set.wait_timeout(timeout)?,
            None => Some(self.set.wait()?),
        };
        Ok(ready.map(|it| it.tag))
    }

    /// Subscribes to the topics of the domain that the rules let out.
    fn follow_domain(&mut self) -> Result<(), BridgeError> {
        while !self.watch.try_wait()?.is_empty() {}
        self.inbound.follow(self.watch.domain());
        if let Some(shadow) = &mut self.shadow {
            shadow.follow(self.watch.domain());
        }
        let mut wanted = published(self.watch.domain());
        wanted.retain(|(topic, _)| self.config.allows(topic, Direction::Out));
        let all = self.outgoing.keys();
        let gone: Vec<_> = all.filter(|it| !wanted.contains(it)).cloned().collect();
        for topic in gone {
            // The messages that its publishers have left.
            self.forward(&topic);
            self.unsubscribe(&topic);
        }
        for topic in wanted {
            if !self.outgoing.contains_key(&topic) {
                self.subscribe(topic);
            }
        }
        Ok(())
    }

    fn subscribe(&mut self, topic: Topic) {
        let builder = self.node.subscriber_builder::<[u8]>(topic.0.as_str());
        let declared = builder.type_id(topic.1.clone()).depth(DEPTH).declare();
        let subscriber = match declared {
            Ok(subscriber) => subscriber,
            Err(error) => {
                tracing::warn!(topic = %topic.0, %error, "cannot subscribe");
                return;
            }
        };
        match self
            .set
            .add(&subscriber, Ready::Topic(Arc::new(topic.clone())))
        {
            Ok(key) => {
                let outgoing = Outgoing {
                    subscriber,
                    key,
                    origin: self.origins.begin(wall_time().0),
                };
                self.outgoing.insert(topic, outgoing);
            }
            Err(error) => tracing::warn!(topic = %topic.0, %error, "cannot wait for messages"),
        }
    }

    /// Takes messages of a topic of the domain.
    fn forward(&mut self, topic: &Topic) {
        let Some(outgoing) = self.outgoing.get_mut(topic) else {
            return;
        };
        for _ in 0..BURST {
            let sample = match outgoing.subscriber.try_recv() {
                Ok(Some(sample)) => sample,
                Ok(None) => return,
                Err(error) => {
                    tracing::warn!(topic = %topic.0, %error, "cannot take a message");
                    self.unsubscribe(topic);
                    return;
                }
            };
            self.counts.lost += sample.lost();
            if is_remote(sample.publisher()) {
                continue;
            }
            outgoing.origin.number += 1;
            let message = Durable::new(topic, &outgoing.origin, &sample);
            if let Err(error) = self.outbox.offer(message, now()) {
                tracing::warn!(topic = %topic.0, %error, "a message is lost");
            }
        }
    }

    fn unsubscribe(&mut self, topic: &Topic) {
        if let Some(outgoing) = self.outgoing.remove(topic) {
            self.set.remove(outgoing.key);
        }
    }

    /// Sends what can be sent.
    fn send(&mut self) {
        loop {
            match self.outbox.poll(now()) {
                Ok(Some(message)) => self.stream.publish(message),
                Ok(None) => return,
                Err(error) => tracing::warn!(%error, "a message is lost"),
            }
        }
    }

    fn follow_stream(&mut self) -> Result<(), BridgeError> {
        self.stream.clear_ready();
        while let Some(event) = self.stream.next() {
            match event {
                Event::Connected => self.outbox.connect(),
                Event::Disconnected => self.outbox.disconnect(now()),
                Event::Acknowledged(topic, origin) => self.outbox.acknowledge(&topic, &origin),
                // The domain has no names for it.
                Event::Message(None, receipt) => self.stream.acknowledge(receipt),
                Event::Message(Some(message), receipt) => self.receive(message, receipt),
            }
        }
        Ok(())
    }

    /// Publishes a message of the stream in the domain.
    fn receive(&mut self, message: Message, receipt: Receipt) {
        if let Some(shadow) = &mut self.shadow {
            shadow.note(SubjectKind::Topic, &message.arrival.topic.0);
        }
        let Message { arrival, payload } = message;
        let domain = self.watch.domain();
        let delivered = Delivered { payload, receipt };
        (self.inbound).receive(&self.config.rules, domain, arrival, delivered);
    }

    /// Counts messages of the stream that have come to their end. The stream delivers those again that the domain
    /// refuses, or that found no room.
    fn note(&mut self, ended: Vec<Ended<Delivered>>) {
        for it in ended {
            self.counts.note(it.verdict);
            if !matches!(it.verdict, Verdict::Refused | Verdict::Dropped) {
                self.stream.acknowledge(it.message.receipt);
            }
        }
    }
}

/// A message of the stream that is not acknowledged yet.
struct Delivered {
    payload: Bytes,
    receipt: Receipt,
}

impl Payload for Delivered {
    fn payload(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.payload)
    }
}
