//! The names of the topic and the service of a node's parameters.

/// The beginning of the names.
const PREFIX: &str = "parameters/";

/// The name of the topic and of the service of a node's parameters: `parameters/NODE`.
//= SM2-PRM-001
#[must_use]
pub fn name(node: &str) -> String {
    format!("{PREFIX}{node}")
}

/// The node whose parameters a topic or a service of this name has.
#[must_use]
pub fn node_of(name: &str) -> Option<&str> {
    name.strip_prefix(PREFIX)
}
