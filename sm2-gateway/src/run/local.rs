//! The task that owns the domain's nodes, on a thread of its own: its calls of the Manager block.

use std::io;

use tokio::{runtime::Handle, sync::oneshot};

use crate::{
    channel::{
        hub::{HubEvent, HubHandle},
        local::LocalInbox,
    },
    local::{Local, LocalError},
    retry,
};

/// Starts the thread, which joins the domain and then handles commands until the hub has ended.
///
/// # Errors
/// The errors of `join`, and those of starting a thread.
pub(super) async fn start(
    join: impl FnOnce() -> Result<Local, LocalError> + Send + 'static,
    inbox: LocalInbox,
    hub: HubHandle,
) -> Result<(), LocalError> {
    let runtime = Handle::current();
    let (joined, result) = oneshot::channel();
    sm2_io::spawn_without_signals("local".to_owned(), move || {
        runtime.block_on(async {
            let (local, result) = match join() {
                Ok(local) => (Some(local), Ok(())),
                Err(error) => (None, Err(error)),
            };
            // Fails if the start of the gateway was aborted.
            if let (Some(local), Ok(())) = (local, joined.send(result)) {
                run(local, inbox, hub).await;
            }
        });
    })?;
    let panicked = |_| io::Error::other("the thread `local` panicked");
    result.await.map_err(panicked)?
}

async fn run(mut local: Local, mut inbox: LocalInbox, hub: HubHandle) {
    let mut pauses = retry::pauses();
    let mut retry_at = None;
    loop {
        retry_at = match local.has_missing() {
            true => retry_at.or_else(|| Some(tokio::time::Instant::now() + pauses.wait())),
            false => {
                pauses = retry::pauses();
                None
            }
        };
        let wait = async {
            match retry_at {
                Some(at) => tokio::time::sleep_until(at).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            // A gateway that has stopped needs no other command, and its runtime may have ended.
            biased;
            command = inbox.recv() => {
                let Some(command) = command else { return };
                if let Some(event) = local.handle(command) {
                    // Fails only if the hub has stopped, and then nobody counts.
                    let _ = hub.send(HubEvent::Local(event)).await;
                }
            }
            () = wait => {
                retry_at = None;
                local.retry();
            }
        }
    }
}
