//! The place to which the payloads of a peer are written.

use quinn_proto::Connection;
use sm2_proto::Instant;

use crate::tally::Tally;

/// The connection to which payloads are written, and the counters that record them.
pub(super) struct Outlet<'a> {
    pub(super) now: Instant,
    pub(super) connection: &'a mut Connection,
    pub(super) tally: &'a mut Tally,
}
