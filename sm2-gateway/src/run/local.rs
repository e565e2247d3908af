//! The task that owns the domain's nodes.

use tokio::task::block_in_place;

use crate::{channel::local::LocalInbox, local::Local};

pub(super) async fn run(mut local: Local, mut inbox: LocalInbox) {
    while let Some(command) = inbox.recv().await {
        // A call of the Manager blocks this thread; the other tasks continue on other threads.
        block_in_place(|| local.handle(command));
    }
}
