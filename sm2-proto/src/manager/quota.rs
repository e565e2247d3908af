//! Quotas: refusals of what exceeds a limit.

use crate::{Quota, Refusal};

/// Refuses a count above `limit`.
//= SM2-IFC-006
pub(super) fn within(limit: usize, wanted: usize, quota: Quota) -> Result<(), Refusal> {
    if wanted <= limit {
        return Ok(());
    }
    Err(Refusal::Quota {
        quota,
        limit: count(limit),
    })
}

/// A count as a frame carries it.
pub(super) fn count(count: impl TryInto<u32>) -> u32 {
    count.try_into().unwrap_or(u32::MAX)
}
