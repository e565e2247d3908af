//! Durations in text form: `200ms`, `5s`, `1.5h`.
//!
//! The crate `humantime` accepts neither fractions (`1.5h`) nor a plain `0`.

use std::{fmt, time::Duration};

/// The units, with their lengths in nanoseconds.
const UNITS: [(&str, f64); 6] = [
    ("ns", 1.0),
    ("us", 1e3),
    ("ms", 1e6),
    ("s", 1e9),
    ("m", 60e9),
    ("h", 3_600e9),
];

/// The longest duration that is accepted. It prevents overflow of deadlines.
const MAX: Duration = Duration::from_secs(365 * 24 * 3_600);

/// The error for a text that is not a duration.
const FORM: &str = "a time is a number and a unit, such as 200ms, 5s or 1.5m (ns, us, ms, s, m, h)";

/// Parses a duration above zero.
pub(crate) fn span(text: &str) -> Result<Duration, String> {
    match span_or_zero(text)? {
        Duration::ZERO => Err("a time above 0 is needed".into()),
        span => Ok(span),
    }
}

/// Parses a duration, which may be zero.
pub(crate) fn span_or_zero(text: &str) -> Result<Duration, String> {
    let number_len = text
        .find(|c: char| !(c.is_ascii_digit() || c == '.'))
        .unwrap_or(text.len());
    let (number, unit) = text.split_at(number_len);
    let unit = unit.trim_start();
    // A number without a unit would be ambiguous: programs disagree on seconds and milliseconds.
    let found = UNITS.iter().find(|(name, _)| *name == unit);
    let nanos = match (found, number.parse::<f64>()) {
        (Some((_, factor)), Ok(number)) => number * factor,
        (None, Ok(number)) if number == 0.0 && unit.is_empty() => 0.0,
        _ => return Err(FORM.into()),
    };
    if nanos > MAX.as_nanos() as f64 {
        return Err("a time is at most 8760h (a year)".into());
    }
    Ok(Duration::from_nanos(nanos as u64))
}

/// A duration in a suitable unit, with at most one decimal: `250 ms`, `1.5 s`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Span(pub(crate) Duration);

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let nanos = self.0.as_nanos();
        let (unit, factor) = match nanos {
            0..1_000 => return write!(f, "{nanos} ns"),
            1_000..1_000_000 => ("us", 1_000),
            1_000_000..1_000_000_000 => ("ms", 1_000_000),
            _ => ("s", 1_000_000_000),
        };
        match (nanos / factor, nanos % factor / (factor / 10)) {
            (whole, 0) => write!(f, "{whole} {unit}"),
            (whole, tenth) => write!(f, "{whole}.{tenth} {unit}"),
        }
    }
}

#[cfg(test)]
mod tests;
