//! What goes into a hub and comes out of it.

use bytes::Bytes;
use sm2_proto::{
    Instant, Name,
    gateway::{Direction, GatewayId, OfferId, Outcome, Subject},
};

use super::Policy;
use crate::{
    peer::{CallId, Command, ConnectionId, Event},
    tally::{Counts, Key},
};

/// The domain's side's number of a request to a server that stands for a remote one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId(pub u64);

/// What happened.
#[derive(Clone, Debug)]
pub enum Input {
    /// On a connection.
    Peer {
        /// Which.
        connection: ConnectionId,
        /// Whether this side opened it.
        is_dialled: bool,
        /// What.
        event: Event,
    },
    /// In the domain.
    Local(LocalEvent),
    /// There are other rules.
    Policy(Policy),
    /// What the hub has put out found no room.
    NoRoom(NoRoom),
    /// A peer is not trusted any more.
    Distrust(GatewayId),
}

/// A message that a queue behind the hub had no room for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoRoom {
    /// A [`Command::Message`].
    ForPeer {
        /// On which connection.
        connection: ConnectionId,
        /// Of which offer.
        offer: OfferId,
    },
    /// A [`LocalCommand::Publish`].
    ForDomain {
        /// Of what.
        subject: Subject,
        /// Of which gateway's domain.
        origin: GatewayId,
    },
}

/// What is to be done.
#[derive(Clone, Debug)]
pub enum Output {
    /// On a connection.
    Peer {
        /// Which.
        connection: ConnectionId,
        /// What.
        command: Command,
    },
    /// In the domain.
    Local(LocalCommand),
    /// There is a connection with this peer: for those who look for it.
    Connected {
        /// With whom.
        peer: GatewayId,
        /// Of its process.
        epoch: u64,
        /// What people call it.
        name: Name,
    },
    /// There is none any more.
    Lost {
        /// With whom.
        peer: GatewayId,
    },
}

/// What happened in the domain.
#[derive(Clone, Debug)]
pub enum LocalEvent {
    /// Whether the domain has publishers or servers of this, besides those that stand for remote ones.
    Present {
        /// Of what.
        subject: Subject,
        /// Whether it has.
        present: bool,
    },
    /// Whether the domain has subscribers of what comes from there.
    Taken {
        /// What.
        subject: Subject,
        /// From which gateway's domain.
        origin: GatewayId,
        /// How many messages wait for them at most, if there is anybody.
        taken: Option<u16>,
    },
    /// The domain's publishers published this.
    Message {
        /// Of what.
        subject: Subject,
        /// When.
        published: Instant,
        /// Its bytes.
        payload: Bytes,
    },
    /// Somebody called a server that stands for a remote one.
    Request {
        /// The domain's name for it: in the [`LocalCommand::Reply`].
        request: RequestId,
        /// Which service.
        subject: Subject,
        /// Of which gateway's domain.
        origin: GatewayId,
        /// When the caller gives up.
        deadline: Option<Instant>,
        /// The request.
        payload: Bytes,
    },
    /// The caller does not want the reply any more.
    Dropped {
        /// Of which request.
        request: RequestId,
    },
    /// A server of the domain has replied.
    Replied {
        /// To which [`LocalCommand::Call`].
        call: CallId,
        /// How it went.
        outcome: Outcome,
        /// The reply, or why it failed.
        payload: Bytes,
    },
}

/// What is to be done in the domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LocalCommand {
    /// Take what the domain's publishers publish, or be a client of its servers.
    Subscribe {
        /// Of what.
        subject: Subject,
        /// How many messages wait for a peer at most.
        depth: u16,
    },
    /// Do not any more.
    Unsubscribe {
        /// Of what.
        subject: Subject,
    },
    /// Be a publisher or a server that stands for the remote ones.
    Show {
        /// Of what.
        subject: Subject,
        /// Of which gateway's domain.
        origin: GatewayId,
        /// What people call the peer that it comes by.
        peer: Name,
    },
    /// Do not any more.
    Hide {
        /// Of what.
        subject: Subject,
        /// Of which gateway's domain.
        origin: GatewayId,
    },
    /// Publish a remote message.
    Publish {
        /// Of what.
        subject: Subject,
        /// Of which gateway's domain.
        origin: GatewayId,
        /// Its bytes.
        payload: Bytes,
    },
    /// Call a server of the domain.
    Call {
        /// The hub's name for it: in the [`LocalEvent::Replied`].
        call: CallId,
        /// Which service.
        subject: Subject,
        /// When the caller gives up.
        deadline: Option<Instant>,
        /// The request.
        payload: Bytes,
    },
    /// Nobody waits for the reply any more.
    Cancel {
        /// Of which call.
        call: CallId,
    },
    /// Reply to a request.
    Reply {
        /// Which.
        request: RequestId,
        /// How it went.
        outcome: Outcome,
        /// The reply, or why it failed.
        payload: Bytes,
    },
}

/// A peer that there is a connection with.
#[derive(Clone, Debug)]
pub struct PeerStatus {
    /// Who it is.
    pub id: GatewayId,
    /// What people call it.
    pub name: Name,
    /// The connection.
    pub connection: ConnectionId,
    /// Of its process.
    pub epoch: u64,
    /// What it offers.
    pub offers: Vec<Subject>,
    /// What it was offered.
    pub offered: Vec<Subject>,
    /// What the rules keep from it, and do not take from it.
    pub denied: Vec<Denial>,
    /// What the hub alone can count: [`lost`](Counts::lost) and [`skipped`](Counts::skipped).
    pub counts: Counts,
    /// Of that, what is of each topic and service.
    pub counts_by_name: Vec<(Key, Counts)>,
}

/// What the rules deny a peer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Denial {
    /// What is there: in the domain, or the peer offers it.
    pub subject: Subject,
    /// Which of both.
    pub direction: Direction,
    /// The index of the rule that says so; none fits: the answer is no.
    pub rule: Option<usize>,
}
