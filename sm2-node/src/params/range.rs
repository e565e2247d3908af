//! The ranges of numbers.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::value::Value;
use crate::Schema;

/// Two numbers count as equal if they differ by at most this many units of the last place of their sum, as in ROS 2.
const ULPS: f64 = 100.0;

/// The values that an `integer` or a `double` may have: those from `from` to `to` in steps of `step`, counted from
/// `from`, and `to` itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(rename_all = "snake_case")]
pub enum Range {
    /// The range of an `integer`.
    Integer {
        /// The least value.
        from: i64,
        /// The greatest value.
        to: i64,
        /// The distance between two values; 0 for all integers of the range.
        step: u64,
    },
    /// The range of a `double`.
    Double {
        /// The least value.
        from: f64,
        /// The greatest value.
        to: f64,
        /// The distance between two values; 0 for all numbers of the range.
        step: f64,
    },
}

impl Range {
    /// Whether the value is in the range. A value of another type than the range's is not.
    //= SM2-PRM-003
    #[must_use]
    pub fn contains(&self, value: &Value) -> bool {
        match (*self, value) {
            (Self::Integer { from, to, step }, &Value::Integer(value)) => {
                let on_step = || step == 0 || value.abs_diff(from) % step == 0;
                value == to || ((from..=to).contains(&value) && on_step())
            }
            (Self::Double { from, to, step }, &Value::Double(value)) => {
                // An infinite number would be equal to all others by the rule of `equal`.
                if !value.is_finite() {
                    return false;
                }
                if equal(value, from) || equal(value, to) {
                    return true;
                }
                let on_step =
                    || step == 0.0 || equal(value, from + ((value - from) / step).round() * step);
                (from..=to).contains(&value) && on_step()
            }
            _ => false,
        }
    }

    /// Whether the range has values: `from` is at most `to`, the step is not negative, and all of them are finite.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        match *self {
            Self::Integer { from, to, .. } => from <= to,
            Self::Double { from, to, step } => {
                from.is_finite() && to.is_finite() && from <= to && step.is_finite() && step >= 0.0
            }
        }
    }
}

/// Whether two numbers differ by rounding at most.
fn equal(a: f64, b: f64) -> bool {
    (a - b).abs() <= f64::EPSILON * (a + b).abs() * ULPS
}

/// `0.5 to 100.0 in steps of 0.5`
impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Integer { from, to, step: 0 } => write!(f, "{from} to {to}"),
            Self::Integer { from, to, step } => write!(f, "{from} to {to} in steps of {step}"),
            Self::Double {
                from,
                to,
                step: 0.0,
            } => write!(f, "{from:?} to {to:?}"),
            Self::Double { from, to, step } => write!(f, "{from:?} to {to:?} in steps of {step:?}"),
        }
    }
}
