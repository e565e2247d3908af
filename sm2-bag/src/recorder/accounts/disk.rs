//! A disk that stalls, that others fill, and that ends with its recorder.

use std::fs::File;
use std::io;
use std::sync::{Arc, Condvar, Mutex};

use nix::errno::Errno;

use super::random::Random;
use crate::storage::{Storage, SyncWork, is_full};

/// A file on the disk.
pub(super) struct Disk {
    file: File,
    switch: Arc<Switch>,
}

/// Controls the disk.
pub(super) struct Switch {
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    is_stalled: bool,
    error: Option<Errno>,
    free_bytes: u64,
}

impl Disk {
    pub(super) fn new(file: File) -> (Self, Arc<Switch>) {
        let state = State {
            is_stalled: false,
            error: None,
            free_bytes: u64::MAX,
        };
        let switch = Arc::new(Switch {
            state: Mutex::new(state),
            changed: Condvar::new(),
        });
        let its = Arc::clone(&switch);
        (Self { file, switch }, its)
    }
}

impl Switch {
    fn set(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.state.lock().unwrap());
        self.changed.notify_all();
    }

    /// Lets operations wait.
    pub(super) fn stall(&self, is_stalled: bool) {
        self.set(|it| it.is_stalled = is_stalled);
    }

    /// Whether others have filled the disk.
    pub(super) fn fill(&self, is_full: bool, random: &mut Random) {
        let error = random.pick(&[Errno::ENOSPC, Errno::EDQUOT, Errno::EFBIG]);
        self.set(|it| it.error = is_full.then_some(error));
    }

    pub(super) fn set_free(&self, free_bytes: u64) {
        self.set(|it| it.free_bytes = free_bytes);
    }

    /// There is room again.
    pub(super) fn repair(&self) {
        self.set(|it| (it.error, it.free_bytes) = (None, u64::MAX));
    }

    /// Nothing is written any more.
    pub(super) fn kill(&self) {
        self.set(|it| (it.error, it.is_stalled) = (Some(Errno::EIO), false));
    }

    pub(super) fn is_full(&self) -> bool {
        self.state.lock().unwrap().error.is_some()
    }

    /// Waits while the disk stalls. Returns its error.
    fn pass(&self) -> io::Result<()> {
        let state = self.state.lock().unwrap();
        let state = self.changed.wait_while(state, |it| it.is_stalled).unwrap();
        state.error.map_or(Ok(()), |it| Err(it.into()))
    }
}

impl Storage for Disk {
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        let passed = self.switch.pass();
        let len = match &passed {
            Ok(()) => bytes.len(),
            // A full disk takes a part.
            Err(error) if is_full(error) => bytes.len() / 2,
            Err(_) => 0,
        };
        Storage::write_at(&mut self.file, &bytes[..len], offset)?;
        passed
    }

    fn sync(&mut self) -> io::Result<()> {
        self.switch.pass()
    }

    fn begin_sync(&mut self) -> io::Result<Option<SyncWork>> {
        let switch = Arc::clone(&self.switch);
        Ok(Some(Box::new(move || switch.pass())))
    }

    fn free_bytes(&self) -> io::Result<Option<u64>> {
        Ok(Some(self.switch.state.lock().unwrap().free_bytes))
    }
}
