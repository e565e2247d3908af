//! The limits of parameters. SPEC, Annex D, has them for ports.

/// The greatest number of parameters of a node.
//= SM2-PRM-004
pub const PARAMETERS_MAX: usize = 1_024;

/// The greatest length of a parameter's name, in bytes.
pub const NAME_MAX: usize = 255;

/// The greatest length of a description, and of the reason of a refusal, in bytes.
pub const TEXT_MAX: usize = 1_024;

/// The greatest length of an encoded value, in bytes.
pub const VALUE_MAX: usize = 65_536;

/// The greatest length of an encoded table and of an encoded request, in bytes.
pub const TABLE_MAX: usize = 1_048_576;

const _: () = assert!(VALUE_MAX < TABLE_MAX);
