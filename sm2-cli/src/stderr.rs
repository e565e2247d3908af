//! Messages for people, on standard error.

/// Like `eprintln!`, but does not panic if the reader of standard error is gone, as in `sm2 … 2>&1 | head`.
macro_rules! stderr_line {
    ($($argument:tt)*) => {{
        use std::io::Write as _;
        let line = format!($($argument)*);
        let _ = writeln!(std::io::stderr(), "{}", $crate::printable::printable(&line));
    }};
}
