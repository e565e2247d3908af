//! Threads for calls that block.
//!
//! The threads of tokio for such calls (`block_in_place`, `spawn_blocking`, `lookup_host`) make the caller panic if
//! the system cannot start another one.

use std::io;

use tokio::sync::oneshot;

/// Does this work on a thread of its own.
///
/// # Errors
///
/// The system cannot start a thread, or the work panicked.
pub(super) async fn on_thread<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> io::Result<T> {
    let (done, result) = oneshot::channel();
    sm2_io::spawn_without_signals(name.to_owned(), move || {
        // Fails if the task that waits was aborted.
        let _ = done.send(work());
    })?;
    let panicked = |_| io::Error::other(format!("the thread `{name}` panicked"));
    result.await.map_err(panicked)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn work_has_a_result_or_an_error() {
        let name = std::thread::current().id();
        let other = on_thread("work", || std::thread::current().id()).await;
        assert_ne!(other.expect("a thread"), name);
        let error = on_thread("panic", || panic!("on purpose")).await.err();
        let error = error.expect("an error").to_string();
        assert!(error.contains("`panic` panicked"), "{error}");
    }
}
