//! The bridge: one thread, which waits for the domain, its topics and the network at the same time.

use std::collections::BTreeMap;
use std::sync::Arc;

use sm2_bridge_core::domain::{Service, Topic, published};
use sm2_bridge_core::{BridgeError, Inbound, Member, Origin, Origins, SpoolCounts, Verdict};
use sm2_node::clock::wall_time;
use sm2_node::domain::Watch;
use sm2_node::wait_set::Interest;
use sm2_node::{Node, Shutdown, WaitError, WaitSet};
use sm2_proto::gateway::Direction;
use zenoh::query::Query;

use crate::config::{Config, Mode};
use crate::convention::Convention;
use crate::counts::Counts;
use crate::durable::DurableTopics;
use crate::network::{Event, Message, Network};
use crate::outgoing::{Outgoing, subscribe};
use crate::ready::Ready;
use crate::sides::Sides;

/// How many messages of the network are published at once, so that the topics of the domain go on meanwhile.
const BURST: usize = 64;

/// A bridge between a domain and a network.
///
/// Dropping it ends it.
pub struct Bridge {
    config: Config,
    /// The node that subscribes.
    node: Node,
    watch: Watch,
    set: WaitSet<'static, Ready>,
    network: Network,
    convention: Convention,
    outgoing: BTreeMap<Topic, Outgoing>,
    inbound: Inbound,
    origins: Origins,
    /// That of calls.
    origin: Origin,
    /// `None` without a spool.
    durable: Option<DurableTopics>,
    counts: Counts,
}

impl Bridge {
    /// Joins the domain, and opens a session of Zenoh.
    ///
    /// # Errors
    ///
    /// See [`BridgeError`].
    pub fn start(config: &Config) -> Result<Self, BridgeError> {
        let name = &config.name;
        let Member {
            node,
            remote,
            mut watch,
        } = Member::join(&config.domain, name)?;
        let network = Network::open(&config.zenoh)?;
        let mut set = WaitSet::new()?;
        set.add_watch(&mut watch, Ready::Domain)?;
        set.add_descriptor(
            Arc::clone(network.ready()),
            Interest::Readable,
            Ready::Network,
        )?;
        let mut origins = Origins::new(name.clone());
        let durable = match (&config.spool, &config.mode) {
            (Some(spool), Mode::Plain { prefix }) => {
                Some(DurableTopics::start(spool, prefix, name, &network)?)
            }
            _ => None,
        };
        Ok(Self {
            config: config.clone(),
            node,
            watch,
            set,
            convention: Convention::start(config, &network)?,
            network,
            outgoing: BTreeMap::new(),
            inbound: Inbound::new(remote),
            origin: origins.begin(wall_time().0),
            origins,
            durable,
            counts: Counts::default(),
        })
    }

    /// The messages since the start.
    #[must_use]
    pub fn counts(&self) -> Counts {
        Counts {
            dropped: self.network.dropped(),
            ..self.counts
        }
    }

    /// The account of the durable topics. `None` without a spool.
    #[must_use]
    pub fn spool_counts(&self) -> Option<SpoolCounts> {
        self.durable.as_ref().map(DurableTopics::counts)
    }

    /// All counts, for people.
    #[must_use]
    pub fn summary(&self) -> String {
        match self.spool_counts() {
            Some(spool) => format!("{}\ndurable topics: {spool}", self.counts()),
            None => self.counts().to_string(),
        }
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
                Ok(Some(ready)) => match ready {
                    Ready::Domain => self.follow_domain()?,
                    Ready::Network => self.follow_network()?,
                    Ready::Topic(topic) => self.forward(&topic),
                    Ready::Server(service) => self.forward_requests(&service),
                    Ready::Call(number) => self.forward_reply(number),
                },
                Err(WaitError::Shutdown) => return Ok(()),
                Err(error) => return Err(BridgeError::Wait(error)),
            }
            if let Some(durable) = &mut self.durable {
                durable.send(&self.network, &mut self.counts);
            }
        }
    }

    /// The next thing that is ready. `None` if the durable topics have something to send before.
    fn wait(&mut self) -> Result<Option<Ready>, WaitError> {
        let timeout = self.durable.as_ref().and_then(DurableTopics::timeout);
        let ready = match timeout {
            Some(timeout) => self.set.wait_timeout(timeout)?,
            None => Some(self.set.wait()?),
        };
        Ok(ready.map(|it| it.tag))
    }

    /// Offers the topics of the domain to the network, and subscribes to those that the domain wants.
    fn follow_domain(&mut self) -> Result<(), BridgeError> {
        while !self.watch.try_wait()?.is_empty() {}
        let is_allowed = |(topic, _): &Topic| self.config.allows(topic, Direction::Out);
        let mut wanted = published(self.watch.domain());
        wanted.retain(is_allowed);
        let all = self.outgoing.keys();
        let gone: Vec<_> = all.filter(|it| !wanted.contains(it)).cloned().collect();
        for topic in gone {
            // The messages that its publishers have left.
            self.forward(&topic);
            self.unsubscribe(&topic);
            self.outgoing.remove(&topic);
        }
        for topic in wanted {
            if self.outgoing.contains_key(&topic) {
                continue;
            }
            let origin = self.origins.begin(wall_time().0);
            let domain = self.watch.domain();
            let declared = self.convention.declare(
                &self.config,
                &topic,
                origin,
                domain,
                &self.node,
                &self.network,
            )?;
            if let Some(outgoing) = declared {
                self.outgoing.insert(topic.clone(), outgoing);
                self.follow_matching(&topic);
            }
        }
        self.follow_ros2()
    }

    /// Offers the topics and services of nodes of ROS 2 to the domain, and subscribes to those that it wants. By the
    /// convention of SM2, the first message of a topic offers it, and one subscription is for all.
    fn follow_ros2(&mut self) -> Result<(), BridgeError> {
        let Convention::Ros2(ros2) = &mut self.convention else {
            return Ok(());
        };
        let sides = Sides {
            config: &self.config,
            domain: self.watch.domain(),
            node: &self.node,
            remote: self.inbound.remote(),
            network: &self.network,
        };
        let offered = ros2.offered(&sides);
        ros2.follow_subscribers(&sides, &offered)?;
        ros2.follow_services(&sides, &mut self.set)?;
        self.inbound.offer(self.watch.domain(), offered);
        Ok(())
    }

    /// Passes calls of the domain to the network.
    fn forward_requests(&mut self, service: &Arc<Service>) {
        if let Convention::Ros2(ros2) = &mut self.convention {
            self.counts.sent += ros2.requests(service, &self.network, &self.origin, &mut self.set);
        }
    }

    /// Passes a reply of the domain to the network.
    fn forward_reply(&mut self, number: u64) {
        if let Convention::Ros2(ros2) = &mut self.convention {
            self.counts.sent += u64::from(ros2.reply(number));
        }
    }

    /// Subscribes to a topic of the domain while the network has subscribers.
    fn follow_matching(&mut self, topic: &Topic) {
        let Some(outgoing) = self.outgoing.get_mut(topic) else {
            return;
        };
        match (outgoing.is_wanted(), outgoing.taken.is_some()) {
            (true, false) => {
                let subscriber = match subscribe(&self.node, topic) {
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
                    Ok(key) => outgoing.taken = Some((subscriber, key)),
                    Err(error) => {
                        tracing::warn!(topic = %topic.0, %error, "cannot wait for messages")
                    }
                }
            }
            (false, true) => self.unsubscribe(topic),
            _ => {}
        }
    }

    fn unsubscribe(&mut self, topic: &Topic) {
        let outgoing = self.outgoing.get_mut(topic);
        if let Some((_, key)) = outgoing.and_then(|it| it.taken.take()) {
            self.set.remove(key);
        }
    }

    /// Passes messages of a topic to the network.
    fn forward(&mut self, topic: &Topic) {
        let Some(outgoing) = self.outgoing.get_mut(topic) else {
            return;
        };
        let durable = self.durable.as_mut();
        if let Err(error) = outgoing.forward(topic, durable, &mut self.counts) {
            tracing::warn!(topic = %topic.0, %error, "cannot take a message");
            self.unsubscribe(topic);
        }
    }

    fn follow_network(&mut self) -> Result<(), BridgeError> {
        self.network.clear_ready();
        for topic in self.network.take_changed() {
            self.follow_matching(&topic);
        }
        if let Some(tokens) = self.network.take_tokens() {
            if let Some(durable) = &mut self.durable {
                durable.follow_receivers(&tokens, &self.config.name);
            }
            if let Convention::Ros2(ros2) = &mut self.convention {
                ros2.read_graph(&tokens);
                self.follow_ros2()?;
            }
        }
        if let Convention::Ros2(ros2) = &mut self.convention {
            self.counts.received += ros2.replies(&self.network, &mut self.set)?;
        }
        for _ in 0..BURST {
            match self.network.next() {
                Some(Event::Message(message)) => self.receive(&message),
                Some(Event::Query(service, query)) => self.query(&service, query)?,
                None => return Ok(()),
            }
        }
        self.network.wake();
        Ok(())
    }

    /// Publishes a message of the network in the domain.
    fn receive(&mut self, message: &Message) {
        if (self.durable.as_mut()).is_some_and(|it| it.handle(message)) {
            return;
        }
        let Some(arrival) = self.convention.read(message) else {
            self.counts.refused += 1;
            return;
        };
        let domain = self.watch.domain();
        let rules = &self.config.rules;
        let verdict =
            (self.inbound).receive(rules, domain, &arrival, || message.payload.to_bytes());
        *match verdict {
            Verdict::Denied => &mut self.counts.denied,
            Verdict::Returned => &mut self.counts.returned,
            Verdict::Duplicate => &mut self.counts.duplicates,
            Verdict::Refused => &mut self.counts.refused,
            Verdict::Published => &mut self.counts.received,
        } += 1;
        if matches!(verdict, Verdict::Duplicate | Verdict::Published) {
            self.convention.acknowledge(&arrival, &self.network);
        }
    }

    /// Passes a call of the network to the domain.
    fn query(&mut self, service: &Service, query: Query) -> Result<(), BridgeError> {
        let Convention::Ros2(ros2) = &mut self.convention else {
            return Ok(());
        };
        self.counts.received += 1;
        ros2.query(service, query, &mut self.set)
    }
}
