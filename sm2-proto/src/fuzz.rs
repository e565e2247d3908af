//! The bodies of the fuzz targets in `fuzz/`, each beside the machine that it tests.
//!
//! Bodies that compare with an oracle stand beside the oracles, in `tests/fuzzed/`. Bodies of other
//! crates stand in their `fuzz.rs`. All bodies read their bytes with [`Script`].

pub(crate) mod script;

pub use script::Script;

use crate::{domain::Domain, schema::Schema};

/// Pages, changes and counters of a Manager that does not obey SPEC. `query` asks what tools ask of
/// the domain; `sm2-node` has the queries.
pub fn domain_mirror(data: &[u8], query: fn(&Domain)) {
    crate::domain::fuzz::mirror(data, query);
}

/// Beacons of any sender, and the results of attempts to connect.
pub fn gateway_discovery(data: &[u8]) {
    crate::gateway::fuzz::discovery(data);
}

/// Frames and headers of a hostile gateway, and requests of the gateway itself.
pub fn gateway_session(data: &[u8]) {
    crate::gateway::fuzz::session(data);
}

/// Datagrams and operations on one end of a link, in any order.
pub fn link_frames(data: &[u8]) {
    crate::link::fuzz::frames(data);
}

/// Operations on a few sessions of one Manager, in any order.
pub fn manager_session(data: &[u8]) {
    crate::manager::fuzz::session(data);
}

/// Frames of a hostile Manager and operations on one node, in any order.
pub fn node_session(data: &[u8]) {
    crate::node::fuzz::session(data);
}

/// Operations on one end of a link on the ring lane, whose memory answers with words from the
/// input.
pub fn ring_words(data: &[u8]) {
    crate::link::fuzz::words(data);
}

/// Two schema texts with a line feed between them. Returns the schemas, if both texts are schemas.
pub fn schema_text(data: &[u8]) -> Option<[Schema; 2]> {
    crate::schema::fuzz::text(data)
}
