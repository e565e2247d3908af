//! The bodies of fuzz targets in `fuzz/`, each beside the machine that it is about.
//!
//! Those that compare with an oracle are with the oracles, in `tests/fuzzed/`; those of other
//! crates in the `fuzz.rs` of these. [`Script`] is what all of them read.

pub(crate) mod script;

pub use script::Script;

/// Pages, changes and counters of a Manager that does not obey SPEC.
pub fn domain_mirror(data: &[u8]) {
    crate::domain::fuzz::mirror(data);
}

/// Beacons that anybody sends, and what becomes of attempts to connect.
pub fn gateway_discovery(data: &[u8]) {
    crate::gateway::fuzz::discovery(data);
}

/// Frames and headers of a hostile gateway, and what the gateway itself asks for.
pub fn gateway_session(data: &[u8]) {
    crate::gateway::fuzz::session(data);
}

/// Datagrams and operations on one end of a link, in the order that the bytes say.
pub fn link_frames(data: &[u8]) {
    crate::link::fuzz::frames(data);
}

/// Operations on a few sessions of one Manager, in the order that the bytes say.
pub fn manager_session(data: &[u8]) {
    crate::manager::fuzz::session(data);
}

/// Frames of a hostile Manager and operations on one node, in the order that the bytes say.
pub fn node_session(data: &[u8]) {
    crate::node::fuzz::session(data);
}

/// Operations on one end of a link of the ring lane, whose words answer what the bytes say.
pub fn ring_words(data: &[u8]) {
    crate::link::fuzz::words(data);
}

/// Two schema texts, parted by a line feed.
pub fn schema_text(data: &[u8]) {
    crate::schema::fuzz::text(data);
}
