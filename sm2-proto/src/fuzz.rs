//! The bodies of the fuzz targets in `fuzz/`, each beside the machine that it is about.

/// Datagrams and operations on one end of a link, in the order that the bytes say.
pub fn link_frames(data: &[u8]) {
    crate::link::fuzz::frames(data);
}

/// Operations on a few sessions of one Manager, in the order that the bytes say.
pub fn manager_session(data: &[u8]) {
    crate::manager::fuzz::session(data);
}
