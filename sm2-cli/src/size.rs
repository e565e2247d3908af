//! Sizes in text form: `4096`, `4KB`, `1.5MiB`.
//!
//! The crates for sizes compute in floating point, and silently drop a fraction of a byte. Here a size is exact or
//! refused.

use std::{fmt, str::FromStr};

use sm2_proto::{limits::MESSAGE_MAX, text::Counted};

/// A number of bytes, from one to the largest message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Size(pub(crate) u64);

/// The longest message that a command reads. It is held in memory as a whole.
pub(crate) const MESSAGE_MAX_BYTES: u64 = 4 << 30;

/// The reason why a text is not a [`Size`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum SizeError {
    /// The text is not a number with a unit.
    #[error(
        "a size is a number and a unit, such as 10MB: B, KB, MB, GB (1000) or KiB, MiB, GiB (1024)"
    )]
    Form,
    /// The size is not a whole number of bytes.
    #[error("a size is a whole number of bytes")]
    Fraction,
    /// The size is zero.
    #[error("a size is at least 1 byte")]
    Zero,
    /// The size is larger than the largest message.
    #[error("a size is at most 1 TiB ({MESSAGE_MAX} bytes)")]
    TooLarge,
}

/// The units, with their sizes in bytes. Case does not matter.
const UNITS: [(&str, u128); 12] = [
    ("", 1),
    ("B", 1),
    ("K", 1_000),
    ("KB", 1_000),
    ("M", 1_000_000),
    ("MB", 1_000_000),
    ("G", 1_000_000_000),
    ("GB", 1_000_000_000),
    ("KiB", 1 << 10),
    ("MiB", 1 << 20),
    ("GiB", 1 << 30),
    ("TiB", 1 << 40),
];

/// The largest number of digits. Every number with more digits is too large.
const MAX_DIGITS: usize = 18;

impl FromStr for Size {
    type Err = SizeError;

    fn from_str(text: &str) -> Result<Self, SizeError> {
        let number_len = text
            .find(|c: char| !(c.is_ascii_digit() || c == '.'))
            .unwrap_or(text.len());
        let (number, unit) = text.split_at(number_len);
        let factor = factor_of(unit.trim_start()).ok_or(SizeError::Form)?;
        let (digits, decimals) = decimal(number)?;
        let scale = 10_u128.pow(decimals);
        let bytes = digits * factor;
        if !bytes.is_multiple_of(scale) {
            return Err(SizeError::Fraction);
        }
        match u64::try_from(bytes / scale) {
            Ok(0) => Err(SizeError::Zero),
            Ok(bytes) if bytes <= MESSAGE_MAX => Ok(Self(bytes)),
            _ => Err(SizeError::TooLarge),
        }
    }
}

fn factor_of(unit: &str) -> Option<u128> {
    let mut units = UNITS.iter();
    let (_, factor) = units.find(|(name, _)| name.eq_ignore_ascii_case(unit))?;
    Some(*factor)
}

/// Parses `12.5` as the number 125 with one decimal.
fn decimal(number: &str) -> Result<(u128, u32), SizeError> {
    let (whole, fraction) = match number.split_once('.') {
        Some((_, "")) => return Err(SizeError::Form),
        Some(parts) => parts,
        None => (number, ""),
    };
    if whole.is_empty() {
        return Err(SizeError::Form);
    }
    let digits = format!("{whole}{fraction}");
    if digits.len() > MAX_DIGITS {
        return Err(SizeError::TooLarge);
    }
    let value = digits.parse().map_err(|_| SizeError::Form)?;
    let decimals = u32::try_from(fraction.len()).map_err(|_| SizeError::Form)?;
    Ok((value, decimals))
}

/// `10 MB`, `1.5 kB`, `12 bytes`: at most one decimal, units of 1000.
impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (unit, factor) = match self.0 {
            bytes if bytes < 1_000 => return Counted::new(bytes, "byte").fmt(f),
            bytes if bytes < 1_000_000 => ("kB", 1_000),
            bytes if bytes < 1_000_000_000 => ("MB", 1_000_000),
            _ => ("GB", 1_000_000_000),
        };
        // The decimal is cut, not rounded: 999,999 bytes are 999.9 kB.
        match (self.0 / factor, self.0 % factor / (factor / 10)) {
            (whole, 0) => write!(f, "{whole} {unit}"),
            (whole, tenth) => write!(f, "{whole}.{tenth} {unit}"),
        }
    }
}

#[cfg(test)]
mod tests;
