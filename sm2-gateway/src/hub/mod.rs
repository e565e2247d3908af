//! The hub of a gateway: connects the domain with the peers, and the peers with each other.
//!
//! [`Hub`] knows the routes (`sm2_proto::gateway::router`), the connection of each peer, the last
//! sequence number of each topic, the newest messages of latched topics, and the callers that wait for
//! replies. It is a [`Machine`]: its driver, the task in `run`, does all I/O.
//!
//! Work that concerns thousands of routes is cut into pieces (SM2-GWR-004, SM2-GWO-008). `cargo run --release -p
//! sm2-gateway --example busy` prints the processor times for 16,384 routes of four peers. On a busy machine, the
//! longest piece was 1.2 ms at the end of a connection (81 ms in total), and 0.6 ms with rules that deny everything (61
//! ms in total). A report of the gateway's status is still one piece, of 29 ms there.

mod calls;
mod domain;
mod ended;
mod input;
mod latched;
mod messages;
mod open_calls;
mod output;
mod peer;
mod policy;
mod reload;
mod routes;
mod sequences;
mod shares;
mod status;

use std::{
    collections::{BTreeMap, VecDeque},
    convert::Infallible,
};

use sm2_proto::{
    Code, Instant, Machine, MisuseError, Name,
    gateway::{
        Direction, GatewayId, Hop, OfferId, PeerFarewell, Subject, SubjectKind, Verdict,
        router::{self, Router, Source},
        session::{self, Candidate, ControlCommand, Initiator, older_stays},
    },
};

pub use self::{
    domain::{LocalCommand, LocalEvent, RequestId},
    input::{Input, NoRoom},
    latched::LATCHED_MAX,
    output::Output,
    policy::{DEFAULT_SEND_QOS, Policy},
    shares::{Links, Process, Room},
    status::{Denial, PeerStatus},
};
use self::{
    ended::EndedPeers,
    latched::Latched,
    open_calls::{Caller, OpenCalls},
    peer::Peer,
    policy::Reload,
    sequences::Sequences,
    shares::Shares,
};
use crate::{
    peer::{Command, ConnectionId, Event},
    tally::{Tally, Whose},
};

/// Connects the domain of a gateway with its peers, and the peers with each other.
#[derive(Debug)]
pub struct Hub {
    me: Hop,
    policy: Policy,
    router: Router,
    /// The peer of each connection that has greeted and not ended.
    connections: BTreeMap<ConnectionId, GatewayId>,
    peers: BTreeMap<GatewayId, Peer>,
    ended_peers: EndedPeers,
    /// The peer and offer that bring each wanted remote topic or service.
    routes: BTreeMap<(Subject, GatewayId), (GatewayId, OfferId)>,
    sequences: Sequences,
    latched: Latched,
    shares: Shares,
    calls: OpenCalls,
    reload: Option<Reload>,
    outputs: VecDeque<Output>,
}

impl Machine for Hub {
    type Input<'a> = Input;
    type Output = Output;
    /// A hub never ends.
    type End = Infallible;
    /// Every input is legal once the outputs of the input before are drained; [`Input::NoRoom`] may come
    /// earlier.
    type Misuse = Infallible;

    fn handle(&mut self, now: Instant, input: Input) -> Result<(), MisuseError<Infallible>> {
        debug_assert!(
            matches!(input, Input::NoRoom(_)) || self.outputs.is_empty(),
            "the outputs of the input before have to be polled first"
        );
        match input {
            Input::Peer {
                connection,
                initiator,
                event,
            } => self.peer(now, connection, initiator, event),
            Input::Local(event) => self.local(now, event),
            Input::Policy(policy) => self.reload(now, policy),
            Input::Tick => self.tick(now),
            Input::NoRoom(what) => self.no_room(&what),
            Input::Distrust(peer) => {
                if let Some(connection) = self.connection(&peer) {
                    self.close(connection, PeerFarewell::Done.code());
                }
            }
        }
        Ok(())
    }

    fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// The time when other rules came, or a connection began or ended, as long as pieces of the work follow.
    fn deadline(&self) -> Option<Instant> {
        let changes = self.reload.as_ref().map(|it| it.since);
        let deadline = self.router.deadline().or(changes);
        deadline.or(self.ended_peers.since())
    }
}

impl Hub {
    /// A hub without peers.
    #[must_use]
    pub fn new(me: Hop, policy: Policy) -> Self {
        Self {
            me,
            router: Router::new(me, policy.rules.clone()),
            policy,
            connections: BTreeMap::new(),
            peers: BTreeMap::new(),
            ended_peers: EndedPeers::default(),
            routes: BTreeMap::new(),
            sequences: Sequences::default(),
            latched: Latched::default(),
            shares: Shares::new(Room::UNLIMITED),
            calls: OpenCalls::default(),
            reload: None,
            outputs: VecDeque::new(),
        }
    }

    /// Limits the topics and services of the domain that the gateway takes.
    #[must_use]
    pub fn with_room(mut self, room: Room) -> Self {
        self.shares = Shares::new(room);
        self
    }

    /// The connection with this peer, if there is one.
    #[must_use]
    pub fn connection(&self, peer: &GatewayId) -> Option<ConnectionId> {
        self.peers.get(peer).map(|it| it.connection)
    }

    /// The number of calls without a reply, in both directions.
    #[must_use]
    pub fn open_calls(&self) -> usize {
        self.calls.len()
    }

    /// The number of topics and origins whose last sequence number is remembered.
    #[must_use]
    pub fn remembered(&self) -> usize {
        self.sequences.remembered()
    }

    fn close(&mut self, connection: ConnectionId, code: Code) {
        let command = Command::Close(code);
        self.outputs.push_back(Output::Peer {
            connection,
            command,
        });
    }

    fn tell(&mut self, peer: GatewayId, command: Command) {
        if let Some(it) = self.peers.get(&peer) {
            let connection = it.connection;
            self.outputs.push_back(Output::Peer {
                connection,
                command,
            });
        }
    }

    fn control(&mut self, peer: GatewayId, command: ControlCommand) {
        self.tell(peer, Command::Control(command));
    }

    /// Handles an event of a connection.
    fn peer(&mut self, now: Instant, connection: ConnectionId, initiator: Initiator, event: Event) {
        if let Event::Session(session::Event::Greeted { peer, epoch, name }) = event {
            return self.greeted(now, connection, initiator, peer, epoch, name);
        }
        let Some(&peer) = self.connections.get(&connection) else {
            return;
        };
        match event {
            Event::Session(event) => self.session(now, peer, event),
            // The connection's task handles it.
            Event::NotAsked { .. } => {}
            Event::Ended(_) => self.ended(now, connection, peer),
            Event::Message { offer, message } => self.message(now, peer, offer, message),
            Event::Request {
                call,
                offer,
                deadline,
                payload,
            } => {
                let caller = Caller::Peer { connection, call };
                self.request(now, caller, (peer, offer), deadline, payload);
            }
            Event::Cancelled { call } => self.cancelled(connection, call),
            Event::Reply {
                call,
                outcome,
                payload,
            } => self.replied(call, outcome, payload),
        }
    }

    /// Handles an event of a peer's control stream.
    fn session(&mut self, now: Instant, peer: GatewayId, event: session::Event) {
        match event {
            // `peer` handles `Greeted`; the connection's task handles `Answered`.
            session::Event::Greeted { .. } | session::Event::Answered { .. } => {}
            session::Event::Offered {
                offer,
                subject,
                path,
            } => {
                let Some(&origin) = path.first() else { return };
                if let Some(it) = self.peers.get_mut(&peer) {
                    it.tally.open(Whose::Theirs(offer), &subject);
                    it.offers.insert(offer, (subject.clone(), origin));
                }
                self.route(
                    now,
                    router::Input::Offered {
                        peer,
                        offer,
                        subject,
                        path,
                    },
                );
            }
            session::Event::Gone { offer } => {
                self.route(now, router::Input::Gone { peer, offer });
                if let Some(it) = self.peers.get_mut(&peer) {
                    it.tally.close(Whose::Theirs(offer));
                    it.offers.remove(&offer);
                }
            }
            session::Event::Wanted { offer, depth } => {
                self.route(now, router::Input::Wanted { peer, offer, depth });
                self.replay(peer, offer);
            }
            session::Event::Unwanted { offer } => {
                self.route(now, router::Input::Unwanted { peer, offer })
            }
            session::Event::Asked { ask, kind, name } => {
                let verdict = self.verdict(peer, kind, &name);
                self.control(peer, ControlCommand::Answer { ask, verdict });
            }
        }
    }

    /// A connection has greeted. If there is another one with that peer, one of them is closed.
    //= SM2-GWC-004
    fn greeted(
        &mut self,
        now: Instant,
        connection: ConnectionId,
        initiator: Initiator,
        peer: GatewayId,
        epoch: u64,
        name: Name,
    ) {
        if let Some(it) = self.peers.get(&peer) {
            let older = Candidate {
                epoch: it.epoch,
                initiator: it.initiator,
            };
            let newer = Candidate { epoch, initiator };
            let code = |lost: u64, stays: u64| match lost < stays {
                true => PeerFarewell::Stale.code(),
                false => PeerFarewell::Duplicate.code(),
            };
            if older_stays(self.me.gateway, peer, older, newer) {
                return self.close(connection, code(epoch, it.epoch));
            }
            let (other, code) = (it.connection, code(it.epoch, epoch));
            self.close(other, code);
            self.ended(now, other, peer);
        }
        self.connections.insert(connection, peer);
        self.peers.insert(
            peer,
            Peer {
                connection,
                initiator,
                epoch,
                name: name.clone(),
                offers: BTreeMap::new(),
                offered: BTreeMap::new(),
                tally: Tally::default(),
            },
        );
        self.outputs
            .push_back(Output::Connected { peer, epoch, name });
        self.route(now, router::Input::Up { peer });
    }

    fn ended(&mut self, now: Instant, connection: ConnectionId, peer: GatewayId) {
        self.connections.remove(&connection);
        let ended = self.peers.remove(&peer);
        self.calls_ended(connection);
        self.route(now, router::Input::Down { peer });
        if let Some(ended) = ended {
            self.ended_peers.add(now, ended);
        }
        self.outputs.push_back(Output::Lost { peer });
    }

    /// Handles an event of the domain.
    fn local(&mut self, now: Instant, event: LocalEvent) {
        match event {
            LocalEvent::Present { subject, present } => {
                self.route(now, router::Input::Local { subject, present });
            }
            LocalEvent::Links { subject, links } => {
                self.shares.set_links(&subject, links);
                self.share();
            }
            LocalEvent::Interfaces { most } => {
                self.shares.set_interfaces(most);
                self.share();
            }
            LocalEvent::Taken {
                subject,
                origin,
                taken,
            } => self.route(
                now,
                router::Input::Taken {
                    subject,
                    origin,
                    taken,
                },
            ),
            LocalEvent::Message {
                subject,
                published_at,
                payload,
            } => self.local_message(now, &subject, published_at, payload),
            LocalEvent::Refused { subject } => self.local_refused(&subject),
            LocalEvent::Unpublished { subject, origin } => {
                self.no_room(&NoRoom::ForDomain { subject, origin });
            }
            LocalEvent::Request {
                request,
                subject,
                origin,
                deadline,
                payload,
            } => self.local_request(now, request, (&subject, origin), deadline, payload),
            LocalEvent::Dropped { request } => self.local_dropped(request),
            LocalEvent::Replied {
                call,
                outcome,
                payload,
            } => self.replied(call, outcome, payload),
        }
    }

    //= SM2-GWO-005
    fn verdict(&self, peer: GatewayId, kind: SubjectKind, name: &Name) -> Verdict {
        if !self.policy.rules.allow(kind, name, Direction::Out, &peer) {
            return Verdict::Denied;
        }
        let offered = self.peers.get(&peer).map(|it| &it.offered);
        let is_it = |it: &Subject| it.kind() == kind && it.name() == name;
        match offered.is_some_and(|it| it.values().any(is_it)) {
            true => Verdict::Offered,
            false => Verdict::Absent,
        }
    }

    /// The subject of an offer to a peer, and where it comes from.
    fn source(&self, peer: GatewayId, offer: OfferId) -> Option<(Subject, Source)> {
        let (subject, source) = self.router.source(peer, offer)?;
        Some((subject.clone(), source))
    }
}
