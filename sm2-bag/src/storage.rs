//! The file that a recorder writes.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex, PoisonError};

/// The file that a recorder writes. Tests put a disk that is full, slow or torn in its place.
pub trait Storage: Write + Seek + Send {
    /// Writes everything to the disk that was written before.
    ///
    /// # Errors
    ///
    /// Any error of `fdatasync(2)`.
    fn sync(&mut self) -> io::Result<()>;
}

impl Storage for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}

/// Storage that the MCAP writer owns, and that its user can still synchronize and close.
#[derive(Clone)]
pub(crate) struct SharedStorage(Arc<Mutex<Option<Box<dyn Storage>>>>);

impl SharedStorage {
    pub(crate) fn new(storage: impl Storage + 'static) -> Self {
        Self(Arc::new(Mutex::new(Some(Box::new(storage)))))
    }

    /// Does something with the storage, unless it is closed.
    fn with<R>(&self, work: impl FnOnce(&mut dyn Storage) -> io::Result<R>) -> io::Result<R> {
        let mut storage = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match &mut *storage {
            Some(storage) => work(&mut **storage),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }

    /// Closes the storage: it takes no further bytes.
    pub(crate) fn close(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    pub(crate) fn sync(&self) -> io::Result<()> {
        self.with(|storage| storage.sync())
    }
}

impl Write for SharedStorage {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.with(|storage| storage.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.with(|storage| storage.flush())
    }
}

impl Seek for SharedStorage {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.with(|storage| storage.seek(to))
    }
}
