//! The limits of a Manager as a frame carries them: each one by its name.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

use super::limits::{Limit, Limits};
use crate::Name;

/// One limit of a Manager.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct StatedLimit {
    /// The name, such as `sessions_per_user`. The unit is its end where it is not a count.
    pub name: Name,
    /// The value.
    pub value: u32,
}

/// The limits that a Manager states, and which links it seals. Every node may know them. A Manager of another version
/// can have limits without a [`Limit`], and can lack some.
//= SM2-WCH-005
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct StatedLimits {
    /// The limits in the order in which the Manager states them.
    pub limits: Vec<StatedLimit>,
    /// Whether every link of the domain is sealed.
    pub seal_all: bool,
    /// Whether links between different users may be unsealed.
    pub waive_user_boundary: bool,
}

impl StatedLimits {
    /// The value of a limit, in its [unit](Limit::unit). `None` if the Manager does not state it.
    #[must_use]
    pub fn of(&self, limit: Limit) -> Option<u32> {
        let mut limits = self.limits.iter();
        limits
            .find(|it| it.name.as_str() == limit.name())
            .map(|it| it.value)
    }
}

impl From<Limits> for StatedLimits {
    fn from(limits: Limits) -> Self {
        let stated = |limit: Limit| {
            // The names of all limits are legal: `every_limit_is_stated` shows it.
            let name = Name::new(limit.name()).ok()?;
            let value = limits.of(limit);
            Some(StatedLimit { name, value })
        };
        Self {
            limits: Limit::ALL.into_iter().filter_map(stated).collect(),
            seal_all: limits.seal_all,
            waive_user_boundary: limits.waive_user_boundary,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_limit_is_stated() {
        let mut stated = StatedLimits::from(Limits::all(3).with(Limit::WorkPerTurn, 7));
        for limit in Limit::ALL {
            let value = if limit == Limit::WorkPerTurn { 7 } else { 3 };
            assert_eq!(stated.of(limit), Some(value), "{}", limit.name());
        }
        assert_eq!(stated.limits.len(), Limit::COUNT);
        stated.limits.remove(0);
        assert_eq!(stated.of(Limit::ALL[0]), None);
    }
}
