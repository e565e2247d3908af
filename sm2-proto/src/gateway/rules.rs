//! The rules of a gateway: which topics and services may pass to and from which peer. SPEC section
//! 14.6.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

use super::{GatewayId, Pattern};
use crate::Name;

/// Whether a name belongs to a topic or to a service.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum SubjectKind {
    /// A topic.
    Topic,
    /// A service.
    Service,
}

/// The direction of the messages of a topic, or of the replies of a service, through the gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Direction {
    /// From the peer to this domain.
    In,
    /// From this domain to the peer.
    Out,
}

/// The effect of a rule on the names that it matches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Action {
    /// The subject may pass.
    Allow,
    /// The subject may not pass.
    Deny,
}

/// One rule. It matches a subject if its kind, names, direction and peers all match.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Rule {
    /// The effect on a match.
    pub action: Action,
    /// The kind to match; `None` matches both.
    pub kind: Option<SubjectKind>,
    /// The names to match.
    pub names: Pattern,
    /// The direction to match; `None` matches both.
    pub direction: Option<Direction>,
    /// The peers to match; `None` matches all.
    pub peers: Option<Vec<GatewayId>>,
}

impl Rule {
    fn fits(&self, kind: SubjectKind, name: &Name, direction: Direction, peer: &GatewayId) -> bool {
        self.kind.is_none_or(|it| it == kind)
            && self.direction.is_none_or(|it| it == direction)
            && self.peers.as_ref().is_none_or(|it| it.contains(peer))
            && self.names.fits(name)
    }
}

/// The rules of a gateway. Their order matters: the first match decides.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Rules(pub Vec<Rule>);

/// The decision of the rules about one subject, direction and peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Decision {
    /// The effect.
    pub action: Action,
    /// The index of the rule that decided; `None` if no rule matches, which denies.
    pub rule: Option<usize>,
}

impl Rules {
    /// Applies the first rule that matches. Denies if no rule matches.
    //= SM2-GWR-002
    #[must_use]
    pub fn decide(
        &self,
        kind: SubjectKind,
        name: &Name,
        direction: Direction,
        peer: &GatewayId,
    ) -> Decision {
        let fitting = |rule: &Rule| rule.fits(kind, name, direction, peer);
        let rule = self.0.iter().position(fitting);
        Decision {
            action: rule.map_or(Action::Deny, |index| self.0[index].action),
            rule,
        }
    }

    /// Whether the subject may pass.
    #[must_use]
    pub fn allow(
        &self,
        kind: SubjectKind,
        name: &Name,
        direction: Direction,
        peer: &GatewayId,
    ) -> bool {
        self.decide(kind, name, direction, peer).action == Action::Allow
    }
}
