//! The task that owns the domain's nodes.

use tokio::task::block_in_place;

use crate::{
    channel::{
        hub::{HubEvent, HubHandle},
        local::LocalInbox,
    },
    local::Local,
    retry,
};

pub(super) async fn run(mut local: Local, mut inbox: LocalInbox, hub: HubHandle) {
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
        // A call of the Manager blocks this thread; the other tasks continue on other threads.
        tokio::select! {
            command = inbox.recv() => {
                let Some(command) = command else { return };
                if let Some(event) = block_in_place(|| local.handle(command)) {
                    // Fails only if the hub has stopped, and then nobody counts.
                    let _ = hub.send(HubEvent::Local(event)).await;
                }
            }
            () = wait => {
                retry_at = None;
                block_in_place(|| local.retry());
            }
        }
    }
}
