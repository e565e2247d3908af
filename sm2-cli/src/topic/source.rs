//! The sources of published messages: files, folders and standard input, whole or in parts.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, BufRead, BufReader, Read},
    os::{
        fd::{AsFd, BorrowedFd},
        unix::fs::OpenOptionsExt,
    },
    path::{Path, PathBuf},
    vec,
};

use nix::libc;

use crate::{error::CliError, size::MESSAGE_MAX_BYTES};

/// The value of `--from`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Input {
    /// `-`.
    StandardInput,
    /// A file or folder.
    Path(PathBuf),
}

/// How an input is split into messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Split {
    /// The whole input is one message, even if it is empty.
    Whole,
    /// Each line is a message, without its newline.
    Lines,
    /// A fixed number of bytes is a message; the last message may be shorter.
    Chunks(u64),
}

/// A wait before each read, which a signal can end. A pipe or a person may take long to write.
pub(crate) trait Gate {
    /// Waits until `input` can be read without blocking. Returns false if the command should end instead.
    ///
    /// # Errors
    ///
    /// The error of the wait.
    fn pass(&self, input: BorrowedFd<'_>) -> Result<bool, CliError>;
}

/// An iterator over the messages of all inputs.
pub(crate) struct Messages<'a, G> {
    inputs: vec::IntoIter<Input>,
    split: Split,
    gate: &'a G,
    open: Option<(Input, BufReader<Gated<'a, G>>)>,
}

impl Input {
    /// The inputs that the value names. The inputs of a folder are its regular files in the order of their names,
    /// without hidden files. Every file has been opened once, to report missing permissions early.
    ///
    /// # Errors
    ///
    /// [`CliError::File`] if an input cannot be read, [`CliError::EmptyFolder`].
    pub(crate) fn inputs(&self) -> Result<Vec<Self>, CliError> {
        let path = match self {
            Self::Path(path) => path,
            Self::StandardInput => return Ok(vec![self.clone()]),
        };
        let failed = |source| CliError::file("read", path, source);
        let found = fs::metadata(path).map_err(failed)?;
        let mut files = match found.is_dir() {
            true => files_of(path).map_err(failed)?,
            false => vec![path.clone()],
        };
        if files.is_empty() {
            return Err(CliError::EmptyFolder { path: path.clone() });
        }
        files.sort_unstable();
        let inputs: Vec<_> = files.into_iter().map(Self::Path).collect();
        // A pipe is not opened for a test: its writer would fail when the test closes the pipe.
        if found.is_dir() || found.is_file() {
            for input in &inputs {
                input.open().map_err(|source| input.failed(source))?;
            }
        }
        Ok(inputs)
    }

    fn open(&self) -> io::Result<File> {
        match self {
            Self::StandardInput => Ok(io::stdin().as_fd().try_clone_to_owned()?.into()),
            // Opening a pipe without a writer would block here. The gate waits instead.
            Self::Path(path) => OpenOptions::new()
                .read(true)
                .custom_flags(libc::O_NONBLOCK)
                .open(path),
        }
    }

    fn failed(&self, source: io::Error) -> CliError {
        match self {
            Self::StandardInput => CliError::file("read", Path::new("standard input"), source),
            Self::Path(path) => CliError::file("read", path, source),
        }
    }
}

/// The regular files of a folder, and symbolic links to such, without hidden ones.
fn files_of(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
        let path = entry.path();
        if !hidden && fs::metadata(&path).is_ok_and(|found| found.is_file()) {
            files.push(path);
        }
    }
    Ok(files)
}

impl<'a, G: Gate> Messages<'a, G> {
    pub(crate) fn new(inputs: Vec<Input>, split: Split, gate: &'a G) -> Self {
        Self {
            inputs: inputs.into_iter(),
            split,
            gate,
            open: None,
        }
    }

    /// Reads the next message into `message`. Returns false at the end of all inputs. If the gate ends the
    /// command, `message` may hold a part of a message.
    ///
    /// # Errors
    ///
    /// [`CliError::File`], [`CliError::MessageTooLong`], and the errors of the gate.
    pub(crate) fn next(&mut self, message: &mut Vec<u8>) -> Result<bool, CliError> {
        loop {
            if self.open.is_none() {
                let Some(input) = self.inputs.next() else {
                    return Ok(false);
                };
                let file = input.open().map_err(|source| input.failed(source))?;
                let gate = self.gate;
                self.open = Some((input, BufReader::new(Gated { file, gate })));
            }
            if let Some((input, reader)) = &mut self.open
                && read(reader, self.split, message).map_err(|error| error.of(input))?
            {
                if self.split == Split::Whole {
                    self.open = None;
                }
                return Ok(true);
            }
            self.open = None;
        }
    }
}

/// Reads one message. Returns false at the end of the input.
fn read(reader: &mut impl BufRead, split: Split, message: &mut Vec<u8>) -> Result<bool, ReadError> {
    message.clear();
    let limit = match split {
        Split::Chunks(size) => size,
        Split::Whole | Split::Lines => MESSAGE_MAX_BYTES + 1,
    };
    let mut part = reader.take(limit);
    match split {
        Split::Lines => part.read_until(b'\n', message)?,
        Split::Whole | Split::Chunks(_) => part.read_to_end(message)?,
    };
    if message.len() as u64 > MESSAGE_MAX_BYTES {
        return Err(ReadError::TooLong);
    }
    let found = split == Split::Whole || !message.is_empty();
    if split == Split::Lines && message.last() == Some(&b'\n') {
        message.pop();
    }
    Ok(found)
}

enum ReadError {
    Io(io::Error),
    TooLong,
}

impl From<io::Error> for ReadError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl ReadError {
    fn of(self, input: &Input) -> CliError {
        match (self, input) {
            (Self::Io(source), input) => match source.downcast::<CliError>() {
                // An error of the gate.
                Ok(error) => error,
                Err(source) => input.failed(source),
            },
            (Self::TooLong, Input::StandardInput) => CliError::MessageTooLong {
                path: "standard input".into(),
            },
            (Self::TooLong, Input::Path(path)) => CliError::MessageTooLong { path: path.clone() },
        }
    }
}

/// A file that waits in its gate before each read. The file ends when the gate returns false.
struct Gated<'a, G> {
    file: File,
    gate: &'a G,
}

impl<G: Gate> Read for Gated<'_, G> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            if !self
                .gate
                .pass(self.file.as_fd())
                .map_err(io::Error::other)?
            {
                return Ok(0);
            }
            match self.file.read(buffer) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                result => return result,
            }
        }
    }
}

#[cfg(test)]
mod tests;
