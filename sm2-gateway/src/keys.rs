//! Key files: an Ed25519 private key as PKCS#8 in PEM, readable only by its owner.

use std::{
    fs::{self, OpenOptions},
    io::{self, Write},
    os::unix::fs::{MetadataExt, OpenOptionsExt},
    path::{Path, PathBuf},
};

use pem::{Pem, PemError};
use sm2_io::quic::{KeyError, SecretKey};

const TAG: &str = "PRIVATE KEY";

/// Why a key cannot be made or read.
#[derive(Debug, thiserror::Error)]
pub enum KeyFileError {
    /// The file cannot be read or written.
    #[error("{path}: {source}; `sm2 gateway keygen {path}` makes a key")]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        r#source: io::Error,
    },
    /// The file exists already.
    #[error("{path} exists already and a key is never overwritten: remove it if it is not needed")]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// Other users can read the file.
    #[error("{path} can be read by other users (mode {mode:03o}): `chmod 600 {path}`")]
    Readable {
        /// The file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// The file is not PEM.
    #[error("{path} is not a key file: {source}; `sm2 gateway keygen` makes one")]
    NotPem {
        /// The file.
        path: PathBuf,
        /// The error of the parser.
        r#source: PemError,
    },
    /// The file is PEM, but holds something else than a private key.
    #[error("{path} is not a key file: it holds a {tag}, not a {TAG}")]
    WrongTag {
        /// The file.
        path: PathBuf,
        /// The PEM tag of the file.
        tag: String,
    },
    /// The file holds a private key of another kind.
    #[error("{path} is not the key of a gateway: {source}")]
    WrongKey {
        /// The file.
        path: PathBuf,
        /// Why the key was refused.
        r#source: KeyError,
    },
    /// No key can be generated.
    #[error("cannot generate a key: {0}")]
    Generate(KeyError),
}

/// Generates a key and writes it to a new file that only its owner can read.
///
/// # Errors
/// See [`KeyFileError`]. No file is left behind.
pub fn generate(path: &Path) -> Result<SecretKey, KeyFileError> {
    let key = SecretKey::generate().map_err(KeyFileError::Generate)?;
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
        // Best effort: the file may hold a part of the key.
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
    let pem = pem::parse(text).map_err(|source| KeyFileError::NotPem {
        path: path.into(),
        source,
    })?;
    if pem.tag() != TAG {
        return Err(KeyFileError::WrongTag {
            path: path.into(),
            tag: pem.tag().to_owned(),
        });
    }
    SecretKey::from_pkcs8(pem.contents()).map_err(|source| KeyFileError::WrongKey {
        path: path.into(),
        source,
    })
}

fn io_error(path: &Path, source: io::Error) -> KeyFileError {
    KeyFileError::Io {
        path: path.into(),
        source,
    }
}
