//! Numbers for people.

/// Formats a number with three significant digits, and commas between thousands.
#[must_use]
pub fn number(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let digits = 2 - value.abs().log10().floor() as i32;
    let scale = 10_f64.powi(digits);
    let rounded = (value * scale).round() / scale;
    let text = format!("{rounded:.*}", digits.max(0) as usize);
    let (whole, fraction) = match text.split_once('.') {
        Some((whole, fraction)) => (whole, Some(fraction)),
        None => (&text[..], None),
    };
    let mut grouped = String::new();
    for (at, digit) in whole.char_indices() {
        if at > 0 && digit.is_ascii_digit() && (whole.len() - at) % 3 == 0 && whole[..at] != *"-" {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    match fraction {
        Some(fraction) => format!("{grouped}.{fraction}"),
        None => grouped,
    }
}

#[cfg(test)]
mod tests;
