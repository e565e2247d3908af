//! The nearest counterparts of an interface without links, and what keeps each from being linked.

use std::fmt;

use serde::Serialize;
use sm2_proto::{EntityId, domain::Domain};

use super::{Finding, NearName, Verdict, names, why};

/// The greatest number of counterparts that [`nearest`] returns.
pub const NEAR_MAX: usize = 8;

/// A counterpart that is not linked with an interface, but may have been meant.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Near {
    /// The id of the counterpart.
    pub entity: EntityId,
    /// The reason why the two are not linked.
    pub verdict: Verdict,
}

impl fmt::Display for Near {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.verdict.fmt(f)
    }
}

/// The nearness of a counterpart, nearest first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Rank {
    Matches,
    Refused,
    Mismatches,
    Name(NearName),
}

/// The counterparts that come nearest to being linked with the interface `entity` and are not: the
/// best first, at most [`NEAR_MAX`]. Empty if the domain has no such interface.
#[must_use]
pub fn nearest(domain: &Domain, entity: EntityId) -> Vec<Near> {
    let Some(ours) = domain.interface(entity) else {
        return Vec::new();
    };
    // The cheap comparisons come first, because a verdict looks at every link.
    let counterparts = domain.interfaces().filter_map(|it| {
        let counterpart = it.contract.kind().counterpart() == ours.contract.kind();
        let same_name = it.contract.name() == ours.contract.name();
        let near = names::near(ours.contract.name(), it.contract.name());
        let near = if same_name { None } else { Some(near?) };
        counterpart.then_some((near, it.entity))
    });
    let mut candidates: Vec<_> = counterparts.collect();
    candidates.sort_unstable();
    let linked: Vec<_> = domain.links_of(entity).collect();
    candidates.retain(|&(_, theirs)| !linked.iter().any(|link| link.touches(theirs)));
    let named_alike = candidates.iter().filter(|(near, _)| near.is_none()).count();
    candidates.truncate(NEAR_MAX.max(named_alike));
    let mut near: Vec<_> = candidates
        .into_iter()
        .map(|(_, theirs)| {
            let verdict = why(domain, entity, theirs);
            (rank(&verdict), theirs, verdict)
        })
        .collect();
    near.sort_unstable_by_key(|&(rank, entity, _)| (rank, entity));
    near.truncate(NEAR_MAX);
    near.into_iter()
        .map(|(_, entity, verdict)| Near { entity, verdict })
        .collect()
}

const fn rank(verdict: &Verdict) -> Rank {
    match verdict.finding {
        Finding::Refused { .. } => Rank::Refused,
        Finding::Names { near: Some(near) } => Rank::Name(near),
        _ if verdict.matches() => Rank::Matches,
        _ => Rank::Mismatches,
    }
}
