//! The phases of a connection, each with the data that it may have.

use std::collections::VecDeque;

use bytes::Bytes;
use quinn_proto::StreamId;
use sm2_proto::{Instant, gateway::session::PeerSession};

use super::budget::Member;

/// The part of a connection above QUIC.
#[derive(Debug)]
pub(super) enum Phase {
    /// The handshake is not complete, so the peer is not known.
    Handshake,
    /// The peer is known.
    Session(Box<Open>),
    /// The connection has ended. It answers datagrams until it is drained.
    Over,
}

/// A connection with a known peer.
#[derive(Debug)]
pub(super) struct Open {
    /// The time since which the peer is known.
    pub(super) since: Instant,
    pub(super) session: PeerSession,
    /// The control stream. A peer that dialled has yet to open it.
    pub(super) control: Option<StreamId>,
    /// The bytes that wait for room in the control stream.
    pub(super) control_out: VecDeque<Bytes>,
    /// The share of the gateway's memory.
    pub(super) member: Member,
}

impl Phase {
    pub(super) const fn open(&self) -> Option<&Open> {
        match self {
            Self::Session(open) => Some(open),
            Self::Handshake | Self::Over => None,
        }
    }

    pub(super) const fn open_mut(&mut self) -> Option<&mut Open> {
        match self {
            Self::Session(open) => Some(open),
            Self::Handshake | Self::Over => None,
        }
    }

    pub(super) const fn is_over(&self) -> bool {
        matches!(self, Self::Over)
    }

    pub(super) fn is_control(&self, id: StreamId) -> bool {
        self.open().is_some_and(|it| it.control == Some(id))
    }
}
