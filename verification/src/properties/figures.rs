//! The figures of a run, compared with those of an earlier run.

/// The largest factor between two values of a number with `~`.
const NOISE: f64 = 30.0;

/// A part of the figures.
#[derive(Debug, PartialEq)]
enum Part<'a> {
    /// Words, and numbers that must be equal in each run.
    Exact(&'a str),
    /// A number with `~` in front.
    About(f64),
}

/// True if the figures of two runs agree: numbers with `~` within a factor of 30, all others exactly.
///
/// ```
/// use sm2_verification::properties::same_figures;
///
/// assert!(same_figures("~120000 executions, ~6100/s", "~90000 executions, ~4400/s"));
/// assert!(!same_figures("706 states, 1379 transitions", "707 states, 1379 transitions"));
/// ```
#[must_use]
pub fn same_figures(before: &str, now: &str) -> bool {
    let (before, now) = (parts(before), parts(now));
    let same = |(before, now): (&Part<'_>, &Part<'_>)| match (before, now) {
        (Part::About(before), Part::About(now)) => {
            before == now || (before / NOISE <= *now && *now <= before * NOISE)
        }
        (before, now) => before == now,
    };
    before.len() == now.len() && before.iter().zip(&now).all(same)
}

fn parts(text: &str) -> Vec<Part<'_>> {
    let mut parts = Vec::new();
    for (index, piece) in text.split('~').enumerate() {
        let digits = piece
            .find(|it: char| !it.is_ascii_digit() && it != '.')
            .unwrap_or(piece.len());
        let (number, rest) = piece.split_at(digits);
        match number.parse() {
            Ok(number) if index > 0 => parts.extend([Part::About(number), Part::Exact(rest)]),
            _ => parts.push(Part::Exact(piece)),
        }
    }
    parts
}
