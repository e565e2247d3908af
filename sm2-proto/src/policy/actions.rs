//! The actions that rules are about.

use core::{fmt, str::FromStr};

/// An action of a node that needs a right.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Action {
    /// Declare a publisher on a topic.
    Publish,
    /// Declare a subscriber on a topic.
    Subscribe,
    /// Declare a server of a service.
    Serve,
    /// Declare a client of a service.
    Call,
    /// Get to know that a node, or an interface on a topic or service, exists.
    See,
    /// Read the counters of a node.
    ReadCounters,
}

impl Action {
    /// All actions.
    pub const ALL: [Self; 6] = [
        Self::Publish,
        Self::Subscribe,
        Self::Serve,
        Self::Call,
        Self::See,
        Self::ReadCounters,
    ];

    /// The word for the action in policy files.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Publish => "publish",
            Self::Subscribe => "subscribe",
            Self::Serve => "serve",
            Self::Call => "call",
            Self::See => "see",
            Self::ReadCounters => "read-counters",
        }
    }
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// Reads the [`word`](Action::word) of an action.
impl FromStr for Action {
    type Err = UnknownAction;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let action = Self::ALL.into_iter().find(|it| it.word() == text);
        action.ok_or(UnknownAction)
    }
}

/// A text is not the word of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an action is publish, subscribe, serve, call, see or read-counters")]
pub struct UnknownAction;

/// A set of actions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ActionSet(u8);

impl ActionSet {
    /// All actions.
    pub const ALL: Self = Self((1 << Action::ALL.len()) - 1);

    /// Whether the action is in the set.
    #[must_use]
    pub const fn has(self, action: Action) -> bool {
        self.0 & (1 << action as u8) != 0
    }
}

impl FromIterator<Action> for ActionSet {
    fn from_iter<T: IntoIterator<Item = Action>>(actions: T) -> Self {
        let bits = actions.into_iter().map(|it| 1 << it as u8);
        Self(bits.fold(0, core::ops::BitOr::bitor))
    }
}

#[cfg(test)]
mod tests {
    use alloc::string::ToString as _;

    use super::*;

    #[test]
    fn each_action_is_read_by_its_word_alone() {
        let told = UnknownAction.to_string();
        for action in Action::ALL {
            assert_eq!(action.word().parse(), Ok(action));
            assert!(told.contains(action.word()), "{action}");
        }
        for wrong in ["", "Publish", "publish ", "read_counters", "write"] {
            assert_eq!(wrong.parse::<Action>(), Err(UnknownAction), "{wrong}");
        }
    }
}
