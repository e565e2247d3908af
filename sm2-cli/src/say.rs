//! Talking to people: standard error.

/// As `eprintln!`, but where nobody reads it any more (`sm2 … 2>&1 | head`) that is no reason to
/// panic.
macro_rules! say {
    ($($argument:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), $($argument)*);
    }};
}
