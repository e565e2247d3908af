//! Repeats what fails, with longer and longer pauses.

use std::{future::Future, time::Duration};

use sm2_proto::Backoff;

/// The longest pause after an error.
const PAUSE_MAX: Duration = Duration::from_secs(1);

/// Repeats an operation until it succeeds. Each error is reported. The pauses double from at most 10 ms
/// up to 1 s, so that a persistent error costs neither time nor many lines of a log.
pub(crate) async fn until_ok<T, E, F: Future<Output = Result<T, E>>>(
    mut attempt: impl FnMut() -> F,
    report: impl Fn(&E),
) -> T {
    let mut pauses = pauses();
    loop {
        match attempt().await {
            Ok(value) => return value,
            Err(error) => {
                report(&error);
                tokio::time::sleep(pauses.wait()).await;
            }
        }
    }
}

/// The pauses after errors that follow one another.
pub(crate) const fn pauses() -> Backoff {
    Backoff::new(0, PAUSE_MAX)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_persistent_error_is_reported_rarely() {
        let start = tokio::time::Instant::now();
        let reports = Cell::new(0);
        let attempt = || async {
            match start.elapsed() {
                it if it < Duration::from_secs(60) => Err("refused"),
                it => Ok(it),
            }
        };
        let elapsed = until_ok(attempt, |_| reports.set(reports.get() + 1)).await;
        assert!(elapsed < Duration::from_secs(62), "{elapsed:?}");
        // Pauses of half a second at least, apart from the first few.
        assert!((60..=130).contains(&reports.get()), "{}", reports.get());
    }
}
