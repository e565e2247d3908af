//! Stores received messages as numbered files in a folder.

use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

use crate::error::CliError;

/// A folder that is filled with `000000.bin`, `000001.bin`, and so on.
#[derive(Debug)]
pub(crate) struct Folder {
    path: PathBuf,
    next: u64,
}

impl Folder {
    /// Opens the folder at `path`, and creates it if it does not exist.
    ///
    /// # Errors
    ///
    /// [`CliError::File`] if the folder cannot be created or read, [`CliError::FolderInUse`] if it has messages
    /// of an earlier run.
    pub(crate) fn open(path: &Path) -> Result<Self, CliError> {
        fs::create_dir_all(path).map_err(|source| CliError::file("create folder", path, source))?;
        let failed = |source| CliError::file("read folder", path, source);
        for entry in fs::read_dir(path).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name();
            if is_numbered(name.as_encoded_bytes()) {
                let path = path.to_owned();
                let found = name.to_string_lossy().into_owned();
                return Err(CliError::FolderInUse { path, found });
            }
        }
        Ok(Self {
            path: path.to_owned(),
            next: 0,
        })
    }

    /// Writes the next file, and returns its path. The file appears only when it is complete.
    ///
    /// # Errors
    ///
    /// [`CliError::File`]. No part of the message stays in the folder.
    pub(crate) fn store(&mut self, message: &[u8]) -> Result<PathBuf, CliError> {
        let name = format!("{:06}.bin", self.next);
        let part = self.path.join(format!(".{name}.part"));
        let path = self.path.join(name);
        match write_then_rename(&part, &path, message) {
            Ok(()) => {
                self.next += 1;
                Ok(path)
            }
            Err(source) => {
                // If the partial file exists, this call has created it.
                let _ = fs::remove_file(&part);
                Err(CliError::file("write", &path, source))
            }
        }
    }
}

fn write_then_rename(part: &Path, path: &Path, message: &[u8]) -> io::Result<()> {
    File::create(part)?.write_all(message)?;
    fs::rename(part, path)
}

fn is_numbered(name: &[u8]) -> bool {
    let digits = name.strip_suffix(b".bin").unwrap_or_default();
    digits.len() >= 6 && digits.iter().all(u8::is_ascii_digit)
}

#[cfg(test)]
mod tests;
