//! Memory of SM2 that Python views.

/// The place and the length of the memory of an exporter.
pub(crate) type Memory = (*mut u8, usize);
