//! One gateway: the state machines of the library, driven as `run` drives them, in virtual time.

use std::collections::BTreeMap;

use quinn_proto::{Connection, ConnectionHandle};
use sm2_gateway::{
    clock::Clock,
    hub::{Hub, Input, LocalCommand, LocalEvent, Output, Room},
    peer::{self, Command, ConnectionId, Limits, Me, Peer},
};
use sm2_io::quic::{Arrival, Congestion, Endpoint, SecretKey, Trusted};
use sm2_proto::{
    Instant, Machine, Name,
    gateway::{
        Beacon, GatewayId, Hop,
        discovery::{self, Discovery},
    },
};

use super::{
    domain::{Domain, Nodes},
    ledger::Ledger,
    link::{DRAIN, Link},
    network::{self, Datagram, Network},
    queue::{Queue, lag},
    random::Random,
    rules::RuleSet,
};

/// The capacity of the queue of messages for a connection.
const MESSAGES: usize = 64;

/// An input of the hub.
pub(crate) enum Message {
    Hub(Input),
    Policy(RuleSet),
}

/// The state that all gateways of a simulation share.
pub(crate) struct World {
    pub(crate) clock: Clock,
    pub(crate) network: Network,
    pub(crate) ledger: Ledger,
    /// True if gateways discover each other by beacons.
    pub(crate) beacons: bool,
}

pub(crate) struct Node {
    pub(crate) index: usize,
    pub(crate) hop: Hop,
    pub(crate) endpoint: Endpoint,
    pub(crate) discovery: Discovery,
    pub(crate) hub: Hub,
    pub(crate) links: BTreeMap<ConnectionHandle, Link>,
    epochs: BTreeMap<GatewayId, u64>,
    inbox: Queue<Message>,
    last: ConnectionId,
    pub(crate) domain: Domain,
    random: Random,
}

/// A trusted peer, and whether its address is configured.
pub(crate) struct Known {
    pub(crate) index: usize,
    pub(crate) is_addressed: bool,
}

/// The parameters of a gateway that starts.
pub(crate) struct Start {
    pub(crate) index: usize,
    pub(crate) key: SecretKey,
    pub(crate) epoch: u64,
    pub(crate) known: Vec<Known>,
    pub(crate) rules: RuleSet,
    pub(crate) room: Room,
    pub(crate) nodes: Nodes,
    pub(crate) random: Random,
}

impl Node {
    pub(crate) fn new(now: Instant, start: Start, world: &mut World) -> Self {
        let Start {
            index,
            key,
            epoch,
            known,
            rules,
            room,
            nodes,
            mut random,
        } = start;
        let gateway = key.id();
        let hop = Hop { gateway, epoch };
        let ids = &world.ledger.ids;
        let trusted = Trusted::default();
        trusted.set(known.iter().map(|it| ids[it.index]));
        let seed = Some(random.bytes());
        let endpoint = Endpoint::new(key, trusted, Congestion::NewReno, seed).unwrap();
        let discovery = Discovery::new(now, gateway, random.next(), world.beacons);
        let trusts: Vec<discovery::Input<'_>> = known
            .iter()
            .map(|it| {
                let (peer, address) = (ids[it.index], network::address(it.index));
                let addresses = match it.is_addressed {
                    true => vec![address],
                    false => Vec::new(),
                };
                discovery::Input::Trust {
                    peer,
                    addresses,
                    hosts: 0,
                }
            })
            .collect();
        let hub = Hub::new(hop, rules.policy(ids)).with_room(room);
        world.ledger.policy(now, index, rules);
        let (domain, events) = Domain::new(index, nodes, random.fork());
        let mut node = Self {
            index,
            hop,
            endpoint,
            discovery,
            hub,
            links: BTreeMap::new(),
            epochs: BTreeMap::new(),
            inbox: Queue::new(),
            last: ConnectionId::default(),
            domain,
            random,
        };
        for trust in trusts {
            node.discover(now, trust, world);
        }
        node.local(now, events);
        node
    }

    /// Queues events of the domain for the hub.
    pub(crate) fn local(&mut self, now: Instant, events: Vec<LocalEvent>) {
        for event in events {
            self.tell(now, Message::Hub(Input::Local(event)));
        }
    }

    pub(crate) fn reload(&mut self, now: Instant, rules: RuleSet) {
        self.tell(now, Message::Policy(rules));
    }

    pub(crate) fn tell(&mut self, now: Instant, message: Message) {
        let late = lag(&mut self.random);
        self.inbox.push(now, late, message);
    }

    pub(crate) fn deadline(&mut self) -> Option<Instant> {
        let links = self.links.values_mut().flat_map(|it| {
            let end = it.ended.map(|at| Instant(at.0 + DRAIN));
            let queues = [it.commands.next_at(), it.messages.next_at()];
            [it.peer.deadline(), end].into_iter().chain(queues)
        });
        let own = [
            self.discovery.deadline(),
            self.hub.deadline(),
            self.inbox.next_at(),
            self.domain.deadline(),
        ];
        links.chain(own).flatten().min()
    }

    pub(crate) fn datagram(&mut self, now: Instant, datagram: &Datagram, world: &mut World) {
        let (from, bytes) = (network::address(datagram.from), &datagram.bytes[..]);
        if datagram.is_beacon {
            let input = discovery::Input::Beacon { from, bytes };
            return self.discover(now, input, world);
        }
        let mut answer = Vec::new();
        let moment = world.clock.at(now);
        let arrival = (self.endpoint).handle(moment.quic, from, None, bytes, &mut answer);
        match arrival {
            None => {}
            Some(Arrival::New(handle, connection)) => self.open(handle, None, *connection, world),
            Some(Arrival::Event(handle, event)) => {
                if let Some(link) = self.links.get_mut(&handle) {
                    link.feed(now, peer::Input::Quic(event));
                }
            }
            Some(Arrival::Answer(transmit)) => self.send(now, &transmit, &answer, world),
        }
    }

    pub(crate) fn send(
        &self,
        now: Instant,
        transmit: &quinn_proto::Transmit,
        bytes: &[u8],
        world: &mut World,
    ) {
        let bytes = &bytes[..transmit.size];
        let (from, to) = (self.index, network::index(transmit.destination));
        for bytes in bytes.chunks(transmit.segment_size.unwrap_or(bytes.len())) {
            let datagram = Datagram {
                from,
                to,
                bytes: bytes.to_vec(),
                is_beacon: false,
            };
            world.network.send(now, datagram);
        }
    }

    fn open(
        &mut self,
        handle: ConnectionHandle,
        dialled: Option<GatewayId>,
        connection: Connection,
        world: &World,
    ) {
        self.last.0 += 1;
        let me = Me {
            hop: self.hop,
            name: Name::new(&format!("g{}", self.index)).unwrap(),
        };
        let (epochs, limits) = (self.epochs.clone(), Limits::default());
        let peer = Peer::new(connection, world.clock, me, epochs, limits);
        let link = Link::new(self.last, dialled, peer);
        self.links.insert(handle, link);
    }

    /// Does everything that is due now.
    pub(crate) fn turn(&mut self, now: Instant, world: &mut World) {
        for _ in 0..10_000 {
            let mut is_quiet = true;
            if self.discovery.deadline().is_some_and(|it| it <= now) {
                is_quiet = false;
                self.discover(now, discovery::Input::Tick, world);
            }
            let handles: Vec<ConnectionHandle> = self.links.keys().copied().collect();
            for handle in handles {
                is_quiet &= self.link(now, handle, world);
            }
            while let Some(event) = self.domain.poll(now) {
                self.local(now, vec![event]);
            }
            while let Some(message) = self.inbox.pop(now) {
                is_quiet = false;
                self.message(now, message, world);
            }
            if self.hub.deadline().is_some_and(|it| it <= now) {
                is_quiet = false;
                let Ok(()) = self.hub.handle(now, Input::Tick);
                self.hub_outputs(now, world);
            }
            if is_quiet && self.deadline().is_none_or(|it| it > now) {
                return;
            }
        }
        panic!("{} is never done", self.index);
    }

    /// Feeds discovery and executes its outputs.
    pub(crate) fn discover(
        &mut self,
        now: Instant,
        input: discovery::Input<'_>,
        world: &mut World,
    ) {
        let Ok(()) = self.discovery.handle(now, input);
        while let Some(output) = self.discovery.poll() {
            match output {
                discovery::Output::Dial { peer, address } => {
                    let moment = world.clock.at(now).quic;
                    let (handle, it) = self.endpoint.connect(moment, peer, address).unwrap();
                    self.open(handle, Some(peer), it, world);
                }
                discovery::Output::DialHost { .. } => unreachable!("no host has a name here"),
                discovery::Output::Announce => self.announce(now, world),
            }
        }
    }

    fn announce(&self, now: Instant, world: &mut World) {
        let beacon = Beacon {
            port: 7633,
            gateway: self.hop.gateway,
            epoch: self.hop.epoch,
        };
        for to in (0..world.ledger.ids.len()).filter(|it| *it != self.index) {
            let datagram = Datagram {
                from: self.index,
                to,
                bytes: beacon.to_bytes().to_vec(),
                is_beacon: true,
            };
            world.network.send(now, datagram);
        }
    }

    fn message(&mut self, now: Instant, message: Message, world: &mut World) {
        match message {
            Message::Hub(input) => {
                let Ok(()) = self.hub.handle(now, input);
            }
            Message::Policy(rules) => {
                let policy = rules.policy(&world.ledger.ids);
                world.ledger.trace.add(now, self.index, "other rules");
                world.ledger.policy(now, self.index, rules);
                let Ok(()) = self.hub.handle(now, Input::Policy(policy));
            }
        }
        self.hub_outputs(now, world);
    }

    fn hub_outputs(&mut self, now: Instant, world: &mut World) {
        while let Some(output) = self.hub.poll() {
            let text = super::trace::text(&output);
            world.ledger.trace.add(now, self.index, &text);
            self.output(now, output, world);
        }
    }

    fn output(&mut self, now: Instant, output: Output, world: &mut World) {
        match output {
            Output::Peer {
                connection,
                command,
            } => self.command(now, connection, command, world),
            Output::Local(command) => self.domain_command(now, command, world),
            Output::Waits { subject } => self.domain.waits(&subject),
            Output::Connected { peer, epoch, .. } => {
                self.epochs.insert(peer, epoch);
                let input = discovery::Input::Connected { peer, epoch };
                self.discover(now, input, world);
            }
            Output::Lost { peer } => {
                self.epochs.remove(&peer);
                let input = discovery::Input::Lost { peer };
                self.discover(now, input, world);
            }
        }
    }

    fn domain_command(&mut self, now: Instant, command: LocalCommand, world: &mut World) {
        let events = self.domain.command(now, command, &mut world.ledger);
        self.local(now, events);
    }

    fn command(&mut self, now: Instant, number: ConnectionId, command: Command, world: &World) {
        let peers = self.hub.peers();
        let peer = peers.iter().find(|it| it.connection == number);
        let late = lag(&mut self.random);
        let found = self.links.values_mut().find(|it| it.number == number);
        let Some(link) = found else { return };
        match &command {
            Command::Offer {
                offer,
                subject,
                path,
                ..
            } => {
                let it = (subject.clone(), path.clone());
                link.offers.insert(*offer, it);
            }
            Command::Message { offer, message } => {
                let (subject, path) = &link.offers[offer];
                if let Some(peer) = peer {
                    let to = world.ledger.index(peer.id);
                    let payload = &message.payload;
                    world
                        .ledger
                        .forwarded(self.index, to, subject, path, payload);
                }
                if link.messages.len() < MESSAGES {
                    link.messages.push(now, late, command);
                }
                return;
            }
            _ => {}
        }
        link.commands.push(now, late, command);
    }

    /// The connections that have not ended.
    pub(crate) fn open_peers(&mut self) -> Vec<&mut Peer> {
        let open = self.links.values_mut().filter(|it| it.ended.is_none());
        open.map(|it| &mut it.peer).collect()
    }
}
