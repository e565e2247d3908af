//! Waiting in a set.

use std::time::Duration;

use sm2_node::WaitSet;
use sm2_node::wait_set::Ready;

use super::SOON;

/// Longer than a test may take.
pub(crate) const LONG: Duration = Duration::from_secs(3_600);

pub(crate) fn next<T: Clone>(set: &mut WaitSet<'_, T>) -> Ready<T> {
    set.wait_timeout(SOON).unwrap().expect("a source is ready")
}

/// Whether nothing is ready.
pub(crate) fn is_quiet<T: Clone>(set: &mut WaitSet<'_, T>) -> bool {
    set.try_wait().unwrap().is_none()
}
