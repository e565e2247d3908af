//! The body of a fuzz target in `fuzz/`.

use crate::explain;

/// Pages, changes and counters of a Manager that does not obey SPEC, into what tools show.
pub fn domain_mirror(data: &[u8]) {
    sm2_proto::fuzz::domain_mirror(data, explain::fuzz::query_all);
}
