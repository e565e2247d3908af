//! Standard input, read without waiting for it.

use std::{
    fs::File,
    io::{self, Read},
    os::fd::{AsFd, BorrowedFd},
    time::Duration,
};

/// Lines of standard input, as far as they are there.
pub(crate) struct Input {
    input: File,
    text: Vec<u8>,
}

impl Input {
    pub(crate) fn new() -> Self {
        let input = io::stdin().as_fd().try_clone_to_owned();
        Self {
            input: input.expect("standard input").into(),
            text: Vec::new(),
        }
    }

    /// The lines that are complete; an error at the end of the input.
    pub(crate) fn lines(&mut self) -> io::Result<Vec<String>> {
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

impl AsFd for Input {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.input.as_fd()
    }
}
