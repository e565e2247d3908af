//! Rows of the table whose offender is a node, and the rules that they break.

use super::Row;
use crate::raw::RawNode;

pub(super) type Rows = Vec<Row<RawNode>>;
pub(super) type Rule = super::Rule<RawNode>;

/// The rows of several rules.
pub(super) fn all<const N: usize>(rules: [Rule; N]) -> Rows {
    rules.into_iter().flatten().collect()
}
