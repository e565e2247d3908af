//! Key files: PKCS#8 in PEM, as other tools write them, for the eyes of their owner only.

use std::{
    fs::{self, OpenOptions},
    io::{self, Write},
    os::unix::fs::{MetadataExt, OpenOptionsExt},
    path::{Path, PathBuf},
};

use pem::Pem;
use sm2_io::quic::{KeyError, SecretKey};

const TAG: &str = "PRIVATE KEY";

/// Why there is no key.
#[derive(Debug, thiserror::Error)]
pub enum KeyFileError {
    /// The file is not there, or cannot be read or written.
    #[error("{path}: {source}; `sm2 gateway keygen {path}` makes a key")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file is there already.
    #[error(
        "{path} is there already: a key is never overwritten; remove it first if it is not needed"
    )]
    Exists {
        /// Which file.
        path: PathBuf,
    },
    /// Others can read the file.
    #[error("{path} can be read by others (mode {mode:03o}): `chmod 600 {path}`")]
    Readable {
        /// Which file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// It holds something else.
    #[error("{path} is no key of a gateway: {reason}")]
    NoKey {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The system has no random numbers.
    #[error(transparent)]
    Key(#[from] KeyError),
}

/// Makes a key, in a file that only its owner can read.
///
/// # Errors
/// See [`KeyFileError`]; no file is left behind then.
pub fn generate(path: &Path) -> Result<SecretKey, KeyFileError> {
    let key = SecretKey::generate()?;
    let text = pem::encode(&Pem::new(TAG, key.to_pkcs8()));
    let options = { OpenOptions::new() }
        .write(true)
        .create_new(true)
        .mode(0o600)
        .to_owned();
    let mut file = options.open(path).map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => KeyFileError::Exists { path: path.into() },
        _ => io_error(path, source),
    })?;
    let written = file
        .write_all(text.as_bytes())
        .and_then(|()| file.sync_all());
    if let Err(source) = written {
        // A file that is half a key helps nobody.
        let _ = fs::remove_file(path);
        return Err(io_error(path, source));
    }
    Ok(key)
}

/// Reads a key.
///
/// # Errors
/// See [`KeyFileError`].
pub fn load(path: &Path) -> Result<SecretKey, KeyFileError> {
    let mode = fs::metadata(path).map_err(|it| io_error(path, it))?.mode() & 0o777;
    if mode & 0o077 != 0 {
        let path = path.into();
        return Err(KeyFileError::Readable { path, mode });
    }
    let text = fs::read(path).map_err(|it| io_error(path, it))?;
    let no_key = |reason: String| KeyFileError::NoKey {
        path: path.into(),
        reason,
    };
    let pem = pem::parse(text).map_err(|error| no_key(error.to_string()))?;
    if pem.tag() != TAG {
        return Err(no_key(format!("it holds a {}, not a {TAG}", pem.tag())));
    }
    SecretKey::from_pkcs8(pem.contents()).map_err(|error| no_key(error.to_string()))
}

fn io_error(path: &Path, source: io::Error) -> KeyFileError {
    KeyFileError::Io {
        path: path.into(),
        source,
    }
}
