//! Which names go to which peer, and come from it: SPEC section 14.6.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

use super::{GatewayId, Pattern};
use crate::Name;

/// What a name is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum SubjectKind {
    /// A topic.
    Topic,
    /// A service.
    Service,
}

/// Where messages of a topic go, and from where replies of a service come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Direction {
    /// From the peer to this domain.
    In,
    /// From this domain to the peer.
    Out,
}

/// What a rule says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Action {
    /// It goes.
    Allow,
    /// It does not.
    Deny,
}

/// One line of a configuration.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Rule {
    /// What it says of what it fits.
    pub action: Action,
    /// None: both.
    pub kind: Option<SubjectKind>,
    /// The names that it is about.
    pub names: Pattern,
    /// None: both.
    pub direction: Option<Direction>,
    /// None: all.
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

/// The rules of a gateway, in their order.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Rules(pub Vec<Rule>);

/// What the rules say of one name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Decision {
    /// What is done.
    pub action: Action,
    /// The index of the rule that says so; none fits: it is denied.
    pub rule: Option<usize>,
}

impl Rules {
    /// The first rule that fits decides, and where none does the answer is no.
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

    /// Whether it goes.
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
