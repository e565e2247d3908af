//! Standard input, read without blocking.

use std::{
    fs::File,
    io::{self, Read},
    os::fd::{AsFd, BorrowedFd},
    thread,
    time::Duration,
};

/// Ends this process at once, without an orderly shutdown, when its standard input ends: the tests have
/// ended then.
pub fn abort_at_end() {
    thread::spawn(|| {
        let _ = io::copy(&mut io::stdin(), &mut io::sink());
        std::process::abort();
    });
}

/// The lines of standard input that have arrived.
#[derive(Debug)]
pub struct Input {
    input: File,
    text: Vec<u8>,
}

impl Input {
    /// The standard input of this process.
    #[must_use]
    pub fn new() -> Self {
        let input = io::stdin().as_fd().try_clone_to_owned();
        Self {
            input: input.expect("standard input").into(),
            text: Vec::new(),
        }
    }

    /// Returns the complete lines, or an error at the end of the input.
    ///
    /// # Errors
    ///
    /// `UnexpectedEof` at the end of the input, or an error of the system.
    pub fn lines(&mut self) -> io::Result<Vec<String>> {
        let now = Some(Duration::ZERO);
        if sm2_io::wait_readable(&[self.input.as_fd()], now)? {
            let mut buffer = [0; 4096];
            let len = self.input.read(&mut buffer)?;
            if len == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            self.text.extend(&buffer[..len]);
        }
        let mut lines = Vec::new();
        while let Some(end) = self.text.iter().position(|&byte| byte == b'\n') {
            let line: Vec<u8> = self.text.drain(..=end).collect();
            lines.push(String::from_utf8_lossy(&line).trim().to_owned());
        }
        Ok(lines)
    }
}

impl Default for Input {
    fn default() -> Self {
        Self::new()
    }
}

impl AsFd for Input {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.input.as_fd()
    }
}
