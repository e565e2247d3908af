//! Reading a policy file that is opened once, so that its owner and mode are those of the text that was read.

use std::{
    fs::{File, Metadata, OpenOptions},
    io::{self, Read},
    os::unix::fs::OpenOptionsExt,
    path::Path,
};

use nix::libc;
use sm2_proto::limits::POLICY_FILE_MAX;

use super::error::PolicyFileError;

/// A regular file.
#[derive(Debug)]
pub(super) struct Opened<'a> {
    path: &'a Path,
    file: File,
    pub(super) metadata: Metadata,
}

impl<'a> Opened<'a> {
    pub(super) fn at(path: &'a Path) -> Result<Self, PolicyFileError> {
        // Opening a FIFO would wait for a writer.
        let file = OpenOptions::new()
            .read(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(path)
            .map_err(|source| failed(path, source))?;
        let metadata = file.metadata().map_err(|source| failed(path, source))?;
        if !metadata.is_file() {
            return Err(PolicyFileError::NotAFile { path: path.into() });
        }
        Ok(Self {
            path,
            file,
            metadata,
        })
    }

    pub(super) fn text(self) -> Result<String, PolicyFileError> {
        let mut text = String::new();
        let mut start = self.file.take(POLICY_FILE_MAX + 1);
        let read = start.read_to_string(&mut text);
        read.map_err(|source| failed(self.path, source))?;
        if text.len() as u64 > POLICY_FILE_MAX {
            let path = self.path.into();
            return Err(PolicyFileError::TooLong { path });
        }
        Ok(text)
    }
}

fn failed(path: &Path, source: io::Error) -> PolicyFileError {
    let path = path.into();
    PolicyFileError::Io { path, source }
}
