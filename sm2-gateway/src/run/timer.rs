//! Timers of the tasks.

use sm2_proto::Instant;

/// Sleeps until a deadline; for ever without one.
pub(super) async fn sleep_until(deadline: Option<Instant>) {
    match deadline {
        Some(at) => tokio::time::sleep(at.since(sm2_io::clock::now())).await,
        None => std::future::pending().await,
    }
}
