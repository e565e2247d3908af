//! The link that messages came from.

use std::fmt;
use std::ops::Deref;
use std::sync::{Arc, Weak};

use sm2_io::InUse;
use sm2_proto::control::LinkPeer;
use sm2_proto::link::CellBytes;

use super::token::LinkToken;
use crate::quota::MappedSegment;

/// The link that a message came from. All messages of the link share this value. It keeps neither the node nor its
/// interface alive.
#[derive(Debug)]
pub(crate) struct Origin {
    pub(crate) token: LinkToken,
    /// The other end of the link.
    pub(crate) peer: Arc<LinkPeer>,
    pub(crate) interface: Weak<dyn GiveBack>,
}

/// A segment of the other end of a link. All messages in it share this value, so each costs one reference count.
#[derive(Debug)]
pub(crate) struct LinkSegment {
    pub(crate) origin: Arc<Origin>,
    pub(crate) mapping: MappedSegment,
}

/// The copy of a message that came in a cell of a ring. Only its message reads it; it is written again once that is
/// dropped.
#[derive(Debug)]
pub(crate) struct CellCopy {
    pub(crate) bytes: CellBytes,
    pub(crate) origin: Arc<Origin>,
}

/// The hold of a message on its link, and on the memory of its payload. Dereferences to the origin.
#[derive(Debug)]
pub(crate) enum Held {
    Link(Arc<Origin>),
    Segment(Arc<LinkSegment>),
    Cell(InUse<CellCopy>),
}

impl Held {
    /// Whether the sender waits until the message is released.
    //= SM2-RNG-013
    #[inline]
    pub(crate) const fn is_released(&self) -> bool {
        !matches!(self, Self::Cell(_))
    }
}

impl Deref for Held {
    type Target = Origin;

    #[inline]
    fn deref(&self) -> &Origin {
        match self {
            Self::Link(origin) => origin,
            Self::Segment(segment) => &segment.origin,
            Self::Cell(copy) => &copy.origin,
        }
    }
}

/// The interface that messages are given back to.
pub(crate) trait GiveBack: fmt::Debug + Send + Sync {
    /// Gives back the message with this sequence number, for the application.
    fn give_back(&self, link: LinkToken, sequence: u64);
}

/// The other end of a link, for tests.
#[cfg(test)]
pub(crate) fn any_peer() -> Arc<LinkPeer> {
    use sm2_proto::{Contract, DemandedQos, InterfaceId, Name, NodeId};

    let name = |text| Name::new(text).unwrap();
    Arc::new(LinkPeer {
        node: NodeId(1),
        name: name("peer"),
        interface: InterfaceId(1),
        contract: Contract::Subscriber {
            topic: name("topic"),
            data: None,
            demand: DemandedQos::new(1, 1),
        },
    })
}
