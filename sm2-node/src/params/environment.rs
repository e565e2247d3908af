//! The environment variables of parameters.

use std::ffi::OsString;

/// The variable that names a file of parameters.
pub const FILE_VARIABLE: &str = "SM2_PARAMS";

/// The beginning of the variables that hold values.
const PREFIX: &str = "SM2_PARAM_";

/// Looks up an environment variable. A test has variables of its own.
pub(super) type Lookup<'a> = &'a dyn Fn(&str) -> Option<OsString>;

/// The environment variable of a parameter: `SM2_PARAM_` and its name in upper case, with `_` for each `.` and `-`.
#[must_use]
pub fn variable(name: &str) -> String {
    let upper = name.to_ascii_uppercase();
    format!("{PREFIX}{}", upper.replace(['.', '-'], "_"))
}
