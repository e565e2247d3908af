//! One connection: a state for each phase, with the data that this phase has.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::BTreeSet;

use super::{Credentials, links::Pair, node_record::NodeRecord, phase::Phase};
use crate::{EntityId, Instant, InterfaceId, Name, NodeId, Violation, limits::LINKS_MAX};

/// How the names of standby Managers begin (SM2-RES-009).
pub const STANDBY_PREFIX: &str = "sm2/standby/";

/// | state | leads to | by |
/// | --- | --- | --- |
/// | greeting | resuming, ready | [`welcome`](Self::welcome) |
/// | resuming | ready | [`claimed`](Self::claimed) |
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Session {
    /// Connected; no HELLO has been granted.
    Greeting(Credentials),
    /// Welcomed; the node claims the links that it brought along.
    Resuming {
        node: NodeRecord,
        resumption: Resumption,
    },
    /// Welcomed; the Manager knows all links of the node.
    Ready {
        node: NodeRecord,
        /// Exists until all interfaces are linked with all their matches.
        matching: Option<Matching>,
        /// The time when claims without a counterpart are given up.
        claims_until: Option<Instant>,
    },
}

/// The claims of a node that has not sent CLAIMED yet.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Resumption {
    /// The number of claims that have come.
    claims: usize,
    /// Pairs whose adopted links ended: they are not linked again.
    ended: BTreeSet<Pair>,
}

/// The interfaces that are still to be linked after CLAIMED (SM2-RES-007), or after a DECLARE with
/// many matches (SM2-SES-009).
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Matching {
    /// The next interface, and the counterpart after which to go on.
    next: (InterfaceId, EntityId),
    /// The last interface that is to be linked.
    last: InterfaceId,
    /// Pairs that are not linked again.
    ended: BTreeSet<Pair>,
}

impl Session {
    pub(super) const fn new(credentials: Credentials) -> Self {
        Self::Greeting(credentials)
    }

    pub(super) const fn credentials(&self) -> Credentials {
        match self {
            Self::Greeting(credentials) => *credentials,
            Self::Resuming { node, .. } | Self::Ready { node, .. } => node.credentials(),
        }
    }

    pub(super) const fn phase(&self) -> Phase {
        match self {
            Self::Greeting(_) => Phase::Greeting,
            Self::Resuming { .. } => Phase::Resuming,
            Self::Ready { .. } => Phase::Ready,
        }
    }

    /// The record of the node; `None` until its HELLO is granted.
    pub(super) const fn node(&self) -> Option<&NodeRecord> {
        match self {
            Self::Greeting(_) => None,
            Self::Resuming { node, .. } | Self::Ready { node, .. } => Some(node),
        }
    }

    pub(super) const fn node_mut(&mut self) -> Option<&mut NodeRecord> {
        match self {
            Self::Greeting(_) => None,
            Self::Resuming { node, .. } | Self::Ready { node, .. } => Some(node),
        }
    }

    /// Whether the node is a Manager that waits for the end of this one.
    pub(super) fn is_standby(&self) -> bool {
        self.node()
            .is_some_and(|it| it.name().as_str().starts_with(STANDBY_PREFIX))
    }

    /// Grants HELLO. Only [`Session::Greeting`] has a HELLO to grant.
    pub(super) fn welcome(&mut self, name: Name, resuming: bool) -> Result<(), Violation> {
        let Self::Greeting(credentials) = *self else {
            return Err(violation!(UnexpectedHello, "SM2-SES-001"));
        };
        let node = NodeRecord::new(credentials, name);
        *self = if resuming {
            Self::Resuming {
                node,
                resumption: Resumption::default(),
            }
        } else {
            Self::Ready {
                node,
                matching: None,
                claims_until: None,
            }
        };
        Ok(())
    }

    /// Ends the resumption: all links are claimed, and claims without a counterpart expire at
    /// `claims_until`. The interfaces that exist now are to be linked with all their matches.
    pub(super) fn claimed(self, claims_until: Option<Instant>) -> Self {
        match self {
            Self::Resuming { node, resumption } => Self::Ready {
                matching: Some(Matching {
                    next: (InterfaceId(0), EntityId::FIRST),
                    last: node.last_interface(),
                    ended: resumption.ended,
                }),
                claims_until,
                node,
            },
            Self::Greeting(_) | Self::Ready { .. } => self,
        }
    }

    /// The time when the claims without a counterpart expire.
    pub(super) const fn claims_until(&self) -> Option<Instant> {
        match self {
            Self::Greeting(_) | Self::Resuming { .. } => None,
            Self::Ready { claims_until, .. } => *claims_until,
        }
    }

    /// The claims without a counterpart have expired.
    pub(super) const fn claims_expired(&mut self) {
        if let Self::Ready { claims_until, .. } = self {
            *claims_until = None;
        }
    }

    /// Whether some interfaces are not linked with all their matches yet.
    pub(super) const fn is_matching(&self) -> bool {
        match self {
            Self::Greeting(_) | Self::Resuming { .. } => false,
            Self::Ready { matching, .. } => matching.is_some(),
        }
    }

    /// The next interface to be linked, and after which counterpart. `None` once all are linked.
    pub(super) fn next_to_match(&mut self, node: NodeId) -> Option<(EntityId, EntityId)> {
        let Self::Ready {
            node: record,
            matching,
            ..
        } = self
        else {
            return None;
        };
        let Matching { next, last, .. } = matching.as_ref()?;
        let following = record.interface_from(next.0).filter(|it| it <= last);
        let Some(interface) = following else {
            *matching = None;
            return None;
        };
        let has_begun = next.0 == interface;
        let after = if has_begun { next.1 } else { EntityId::FIRST };
        Some((EntityId { node, interface }, after))
    }

    /// A new interface is linked with its counterparts up to this one. The others are left.
    pub(super) fn begin_matching(&mut self, interface: InterfaceId, up_to: EntityId) {
        if let Self::Ready { matching, .. } = self {
            *matching = Some(Matching {
                next: (interface, up_to),
                last: interface,
                ended: BTreeSet::new(),
            });
        }
    }

    /// Notes that the interface is linked with its counterparts up to this one, or with all of
    /// them.
    pub(super) const fn matched(&mut self, interface: InterfaceId, up_to: Option<EntityId>) {
        if let Self::Ready {
            matching: Some(matching),
            ..
        } = self
        {
            matching.next = match up_to {
                Some(counterpart) => (interface, counterpart),
                None => (InterfaceId(interface.0.saturating_add(1)), EntityId::FIRST),
            };
        }
    }

    /// Whether this pair ended its link before the session was matched.
    pub(super) fn has_ended(&self, pair: Pair) -> bool {
        match self {
            Self::Greeting(_) | Self::Resuming { .. } => false,
            Self::Ready { matching, .. } => matching
                .as_ref()
                .is_some_and(|matching| matching.ended.contains(&pair)),
        }
    }

    /// Notes that a link has ended before the session was matched, and whether its pair is to be
    /// linked again.
    //= SM2-RES-007, SM2-LNK-009
    pub(super) fn ended(&mut self, pair: Pair, again: bool) {
        match self {
            Self::Resuming {
                resumption: Resumption { ended, .. },
                ..
            }
            | Self::Ready {
                matching: Some(Matching { ended, .. }),
                ..
            } => {
                if again {
                    ended.remove(&pair);
                } else {
                    ended.insert(pair);
                }
            }
            Self::Greeting(_) | Self::Ready { matching: None, .. } => {}
        }
    }

    /// Spends a claim. A node has no more open links than the limit of links.
    //= SM2-RES-008
    pub(super) const fn may_claim(&mut self) -> bool {
        match self {
            Self::Greeting(_) | Self::Ready { .. } => false,
            Self::Resuming { resumption, .. } => {
                resumption.claims += 1;
                resumption.claims <= LINKS_MAX
            }
        }
    }
}
