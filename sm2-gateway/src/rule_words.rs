//! The words of rules in the configuration of a gateway, and of other programs that have such rules.

use serde::Deserialize;
use sm2_proto::gateway::{Action, Direction, SubjectKind};

/// The word of a rule's effect: `allow` or `deny`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionWord {
    /// The subject may pass.
    Allow,
    /// The subject may not pass.
    Deny,
}

/// The word of the kind that a rule matches: `topic` or `service`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KindWord {
    /// Topics.
    Topic,
    /// Services.
    Service,
}

/// The word of the direction that a rule matches: `in`, `out` or `both`, which is the default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DirectionWord {
    /// To the domain.
    In,
    /// From the domain.
    Out,
    /// Either way.
    #[default]
    Both,
}

impl From<ActionWord> for Action {
    fn from(word: ActionWord) -> Self {
        match word {
            ActionWord::Allow => Self::Allow,
            ActionWord::Deny => Self::Deny,
        }
    }
}

impl From<KindWord> for SubjectKind {
    fn from(word: KindWord) -> Self {
        match word {
            KindWord::Topic => Self::Topic,
            KindWord::Service => Self::Service,
        }
    }
}

impl From<DirectionWord> for Option<Direction> {
    fn from(word: DirectionWord) -> Self {
        match word {
            DirectionWord::In => Some(Direction::In),
            DirectionWord::Out => Some(Direction::Out),
            DirectionWord::Both => None,
        }
    }
}
