//! The bridge: one thread, which waits for the domain, its topics and the network at the same time.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

use sm2_bridge_core::domain::{Service, Topic, carried_by_gateways, carried_twice, published};
use sm2_bridge_core::{
    Account, BridgeError, Counts, Ended, Inbound, Member, Origin, Origins, ReadAccount, Shadow,
    Verdict,
};
use sm2_node::clock::wall_time;
use sm2_node::domain::Watch;
use sm2_node::wait_set::Interest;
use sm2_node::{Node, Shutdown, WaitError, WaitSet};
use sm2_proto::Name;
use sm2_proto::gateway::{Direction, SubjectKind};
use zenoh::query::Query;

use crate::config::{Config, Mode};
use crate::convention::Convention;
use crate::durable::DurableTopics;
use crate::network::{Event, Message, Network};
use crate::outgoing::{Outgoing, subscribe};
use crate::ready::Ready;
use crate::services::Services;
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
    services: Services,
    outgoing: BTreeMap<Topic, Outgoing>,
    inbound: Inbound<Message>,
    origins: Origins,
    /// That of calls.
    origin: Origin,
    /// `None` without a spool.
    durable: Option<DurableTopics>,
    counts: Counts,
    /// The counts of this thread, for other threads.
    account: Arc<Mutex<Account>>,
    /// Rules that are only compared.
    shadow: Option<Shadow>,
    /// The topics that another bridge of the domain carries in the same direction.
    carried_twice: BTreeSet<(Name, Topic, Direction)>,
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
        let account = Account {
            bridge: name.clone(),
            network: "zenoh",
            counts: Counts::default(),
            spool: durable.as_ref().map(DurableTopics::counts),
        };
        Ok(Self {
            config: config.clone(),
            node,
            watch,
            set,
            convention: Convention::start(config, &network)?,
            network,
            services: Services::default(),
            outgoing: BTreeMap::new(),
            inbound: Inbound::new(remote),
            origin: origins.begin(wall_time().0),
            origins,
            durable,
            counts: Counts::default(),
            account: Arc::new(Mutex::new(account)),
            shadow: None,
            carried_twice: BTreeSet::new(),
        })
    }

    /// The messages since the start. Other threads can read them while the bridge runs, and after it.
    #[must_use]
    pub fn account(&self) -> ReadAccount {
        let (account, network) = (Arc::clone(&self.account), self.network.counts());
        Arc::new(move || {
            let account = account.lock().unwrap_or_else(PoisonError::into_inner);
            let mut account = account.clone();
            let (sent, dropped) = network();
            let counts = &mut account.counts;
            counts.sent = sent.sent;
            counts.superseded = sent.superseded;
            counts.expired = sent.expired;
            counts.withdrawn = sent.withdrawn;
            counts.refused += sent.refused;
            counts.dropped += dropped;
            account
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
                Ok(Some(ready)) => match ready {
                    Ready::Domain => self.follow_domain()?,
                    Ready::Network => self.follow_network()?,
                    Ready::Topic(topic) => self.forward(&topic),
                    Ready::Server(service) => self.forward_requests(&service),
                    Ready::Call(number) => self.forward_reply(number),
                },
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
            if let Some(durable) = &mut self.durable {
                durable.send(&self.network, &mut self.counts);
            }
            self.report();
        }
    }

    /// Shows the account to other threads, and logs what other rules would change.
    fn report(&mut self) {
        let mut account = self.account.lock().unwrap_or_else(PoisonError::into_inner);
        account.counts = self.counts;
        account.spool = self.durable.as_ref().map(DurableTopics::counts);
        drop(account);
        if let Some(shadow) = &mut self.shadow {
            for line in shadow.compare(&self.config.rules) {
                tracing::info!("shadow: {line}");
            }
        }
    }

    /// The next thing that is ready. `None` if durable topics have something to send before, or messages of the network
    /// may wait no longer.
    fn wait(&mut self) -> Result<Option<Ready>, WaitError> {
        let durable = self.durable.as_ref().and_then(DurableTopics::timeout);
        let timeout = [durable, self.inbound.timeout()]
            .into_iter()
            .flatten()
            .min();
        let ready = match timeout {
            Some(timeout) => self.set.wait_timeout(timeout)?,
            None => Some(self.set.wait()?),
        };
        Ok(ready.map(|it| it.tag))
    }

    /// Offers the topics of the domain to the network, and subscribes to those that the domain wants.
    fn follow_domain(&mut self) -> Result<(), BridgeError> {
        while !self.watch.try_wait()?.is_empty() {}
        self.inbound.follow(self.watch.domain());
        if let Some(shadow) = &mut self.shadow {
            shadow.follow(self.watch.domain());
        }
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
        let of_gateways = carried_by_gateways(self.watch.domain());
        for (topic, outgoing) in &mut self.outgoing {
            outgoing.is_beside_gateway = of_gateways.contains(topic);
        }
        self.report_carried_twice();
        self.follow_endpoints()
    }

    /// Warns of each topic that another bridge carries between the same domain and the same network.
    fn report_carried_twice(&mut self) {
        let mut found = carried_twice(self.watch.domain(), &self.config.name);
        found.retain(|(bridge, ..)| self.convention.has_bridge(bridge));
        for (bridge, topic, direction) in found.difference(&self.carried_twice) {
            let direction = match direction {
                Direction::In => "in",
                Direction::Out => "out",
            };
            tracing::warn!(
                %bridge, topic = %topic.0, direction,
                "another bridge of the domain carries this topic, too: each message arrives twice. Deny the topic in \
                 the rules of one bridge"
            );
        }
        self.carried_twice = found;
    }

    /// Offers each side the services of the other one. Offers the topics of nodes of ROS 2 to the domain, and
    /// subscribes to those that it wants. By the convention of SM2, the first message of a topic offers it, and one
    /// subscription is for all.
    fn follow_endpoints(&mut self) -> Result<(), BridgeError> {
        let sides = Sides {
            config: &self.config,
            domain: self.watch.domain(),
            node: &self.node,
            remote: self.inbound.remote(),
            network: &self.network,
        };
        (self.convention).follow_services(&mut self.services, &sides, &mut self.set)?;
        let Convention::Ros2(ros2) = &mut self.convention else {
            return Ok(());
        };
        let offered = ros2.offered(&sides);
        ros2.follow_subscribers(&sides, &offered)?;
        self.inbound.offer(self.watch.domain(), offered);
        Ok(())
    }

    /// Passes calls of the domain to the network.
    fn forward_requests(&mut self, service: &Arc<Service>) {
        (self.services).requests(service, &self.network, &self.origin, &mut self.set);
    }

    /// Passes a reply of the domain to the network.
    fn forward_reply(&mut self, number: u64) {
        self.services.reply(number, &self.network);
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
            self.convention.read_tokens(&tokens);
            self.report_carried_twice();
            self.follow_endpoints()?;
        }
        self.counts.received += self.services.replies(&self.network, &mut self.set)?;
        for _ in 0..BURST {
            match self.network.next() {
                Some(Event::Message(message)) => self.receive(message),
                Some(Event::Query(service, query)) => self.query(&service, query)?,
                None => return Ok(()),
            }
        }
        self.network.wake();
        Ok(())
    }

    /// Publishes a message of the network in the domain.
    fn receive(&mut self, message: Message) {
        if (self.durable.as_mut()).is_some_and(|it| it.handle(&message)) {
            return;
        }
        let Some(arrival) = self.convention.read(&message) else {
            self.counts.refused += 1;
            return;
        };
        if let Some(shadow) = &mut self.shadow {
            shadow.note(SubjectKind::Topic, &arrival.topic.0);
        }
        let domain = self.watch.domain();
        (self.inbound).receive(&self.config.rules, domain, arrival, message);
    }

    /// Counts and acknowledges messages of the network that have come to their end.
    fn note(&mut self, ended: Vec<Ended<Message>>) {
        for it in ended {
            self.counts.note(it.verdict);
            if matches!(it.verdict, Verdict::Duplicate | Verdict::Published) {
                self.convention.acknowledge(&it.arrival, &self.network);
            }
        }
    }

    /// Passes a call of the network to the domain.
    fn query(&mut self, service: &Service, query: Query) -> Result<(), BridgeError> {
        self.counts.received += 1;
        (self.services).query(service, query, &self.network, &mut self.set)
    }
}
