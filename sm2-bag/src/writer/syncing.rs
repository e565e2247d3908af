//! Writing a file to the disk in a thread of its own, while the file grows.

use std::io;
use std::sync::mpsc::{Sender, channel};

use crate::storage::SyncWork;

/// Where the result of a synchronization goes.
pub(super) type Synced = Sender<io::Result<()>>;

/// The thread, which starts with the first work. It ends when the value is dropped.
#[derive(Default)]
pub(super) struct Syncing(Option<Sender<(SyncWork, Synced)>>);

impl Syncing {
    /// Begins the work.
    pub(super) fn begin(&mut self, work: SyncWork, synced: Synced) -> io::Result<()> {
        let thread = match &self.0 {
            Some(thread) => thread,
            None => self.0.insert(start()?),
        };
        // If the thread has panicked, `synced` is dropped, which tells the one that waits.
        let _ = thread.send((work, synced));
        Ok(())
    }
}

fn start() -> io::Result<Sender<(SyncWork, Synced)>> {
    let (work, to_do) = channel::<(SyncWork, Synced)>();
    sm2_io::spawn_without_signals("sm2-bag-sync".to_owned(), move || {
        for (work, synced) in to_do {
            // Nobody waits for the last synchronization of a recording that has failed.
            let _ = synced.send(work());
        }
    })?;
    Ok(work)
}
