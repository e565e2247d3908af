//! The keys of `sm2 play` on a terminal.
//!
//! The thread belongs to the command and not to the player: it must not read the terminal of another job.

use std::{
    fs::File,
    io::{self, IsTerminal, Read},
    os::{
        fd::{AsFd, BorrowedFd, OwnedFd},
        unix::net::UnixStream,
    },
    sync::Arc,
    thread::JoinHandle,
    time::Duration,
};

use nix::{
    errno::Errno,
    sys::termios::{LocalFlags, SetArg, SpecialCharacterIndices, Termios, tcgetattr, tcsetattr},
    unistd::{getpgrp, tcgetpgrp},
};
use signal_hook::{consts::SIGCONT, low_level::pipe};
use sm2_bag::{PlayCommand, PlayControl};
use sm2_io::{Waker, spawn_without_signals};

use super::control::Shown;
use crate::{
    connect::CommandNode,
    wait::{For, wait},
};

/// The meaning of the keys, for a person who has a terminal.
pub(super) const HINT: &str =
    "keys: space pauses and resumes; s or the right arrow steps; + and - change the rate; q ends";

/// How often a command in the background looks whether it has the terminal: a shell says nothing when it puts a job
/// that runs into the foreground.
const BACKGROUND: Duration = Duration::from_secs(1);

/// A thread that reads keys and controls a player. Dropping it restores the terminal.
///
/// The thread also restores the terminal as soon as a signal ends the command: a second signal would leave no time.
pub(super) struct Keys {
    end: Arc<Waker>,
    thread: Option<JoinHandle<()>>,
}

impl Keys {
    /// Reads keys from now on, if standard input is a terminal. Otherwise `None`.
    ///
    /// # Errors
    ///
    /// Errors of the operating system: too many descriptors or threads.
    pub(super) fn start(
        control: PlayControl,
        command_node: &CommandNode,
    ) -> io::Result<Option<Self>> {
        let input = io::stdin();
        if !input.is_terminal() {
            return Ok(None);
        }
        let (continued, written_by_handler) = UnixStream::pair()?;
        continued.set_nonblocking(true)?;
        pipe::register(SIGCONT, written_by_handler)?;
        let end = Arc::new(Waker::new()?);
        let keyboard = Keyboard {
            terminal: Terminal {
                input: File::from(input.as_fd().try_clone_to_owned()?),
                before: None,
            },
            control,
            ends: (
                Arc::clone(&end),
                command_node.signal_fd().try_clone_to_owned()?,
            ),
            continued,
            unread: Vec::new(),
        };
        // Without signals: a terminal that belongs to another job does not stop the command, but fails to be read.
        let thread = spawn_without_signals("sm2-keys".to_owned(), move || keyboard.run())?;
        Ok(Some(Self {
            end,
            thread: Some(thread),
        }))
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        self.end.wake();
        // A panic of the thread has restored the terminal as well.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// The part that the thread owns.
struct Keyboard {
    terminal: Terminal,
    control: PlayControl,
    /// Readable when the command ends: by itself, or by a signal.
    ends: (Arc<Waker>, OwnedFd),
    /// Readable after SIGCONT: the shell has changed the mode of the terminal while the job was stopped.
    continued: UnixStream,
    /// The first bytes of an escape sequence.
    unread: Vec<u8>,
}

impl Keyboard {
    fn run(mut self) {
        // The terminal is gone, or there is no memory: the replay goes on without keys.
        while let Ok(true) = self.step() {}
    }

    /// Waits for the next event. Returns false at the end of the command or of the input.
    fn step(&mut self) -> io::Result<bool> {
        let is_ours = self.terminal.is_ours();
        if is_ours {
            self.terminal.read_single_keys()?;
        }
        let mut sources = vec![
            self.ends.0.as_fd(),
            self.ends.1.as_fd(),
            self.continued.as_fd(),
        ];
        // The keys of another job are not for this command.
        sources.extend(is_ours.then(|| self.terminal.input.as_fd()));
        let sources: Vec<(BorrowedFd<'_>, For)> =
            sources.into_iter().map(|it| (it, For::Reading)).collect();
        let ready = wait(&sources, (!is_ours).then_some(BACKGROUND))?;
        if ready[0] || ready[1] {
            return Ok(false);
        }
        if ready[2] {
            let _ = self.continued.read(&mut [0; 64]);
        }
        match ready.get(3) {
            Some(true) => self.read(),
            _ => Ok(true),
        }
    }

    /// Reads keys, and follows them. Returns false at the end of the input.
    fn read(&mut self) -> io::Result<bool> {
        let mut bytes = [0; 64];
        match self.terminal.input.read(&mut bytes) {
            Ok(0) => return Ok(false),
            Ok(len) => self.unread.extend_from_slice(&bytes[..len]),
            // The job has lost the terminal since the wait.
            Err(error) if error.raw_os_error() == Some(Errno::EIO as i32) => {
                return Ok(!self.terminal.is_ours());
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
        while let Some((key, len)) = first_key(&self.unread) {
            self.unread.drain(..len);
            if let Some(key) = key {
                self.press(key);
            }
        }
        Ok(true)
    }

    fn press(&self, key: Key) {
        let status = self.control.status();
        let command = match key {
            Key::Pause if status.paused => PlayCommand::Resume,
            Key::Pause => PlayCommand::Pause,
            Key::Step => PlayCommand::Step,
            Key::Faster => PlayCommand::Rate(status.rate * 2.0),
            Key::Slower => PlayCommand::Rate(status.rate / 2.0),
            Key::End => return self.control.end(),
        };
        // A step needs a pause, and no rate is twice the greatest one.
        let is_legal = self.control.send(command).is_ok();
        if is_legal && key != Key::Step {
            stderr_line!("{}", Shown(self.control.status()));
        }
    }
}

/// The keys with a meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Key {
    Pause,
    Step,
    Faster,
    Slower,
    End,
}

/// The first key in these bytes, and their number; other keys are `None`. Nothing without a whole key.
fn first_key(bytes: &[u8]) -> Option<(Option<Key>, usize)> {
    let key = match bytes {
        [] | [0x1b] => return None,
        // The sequence of a cursor key or a function key ends with a byte from 0x40 on.
        [0x1b, b'[' | b'O', rest @ ..] => {
            let len = rest.iter().position(|it| *it >= 0x40)?;
            let is_right = len == 0 && rest[0] == b'C';
            return Some((is_right.then_some(Key::Step), len + 3));
        }
        [b' ', ..] => Some(Key::Pause),
        [b's', ..] => Some(Key::Step),
        [b'+' | b'=', ..] => Some(Key::Faster),
        [b'-', ..] => Some(Key::Slower),
        [b'q', ..] => Some(Key::End),
        _ => None,
    };
    Some((key, 1))
}

/// Standard input. Dropping it restores its mode.
struct Terminal {
    input: File,
    /// The mode before this command changed it.
    before: Option<Termios>,
}

impl Terminal {
    /// Whether this job may read it. A terminal that does not control this process has no jobs.
    fn is_ours(&self) -> bool {
        tcgetpgrp(&self.input).map_or(true, |group| group == getpgrp())
    }

    /// Lets each key be read at once, and not be shown. Keys for signals, such as Ctrl-C, stay.
    fn read_single_keys(&mut self) -> nix::Result<()> {
        let mut mode = tcgetattr(&self.input)?;
        let lines = LocalFlags::ICANON | LocalFlags::ECHO;
        if !mode.local_flags.intersects(lines) {
            return Ok(());
        }
        self.before.get_or_insert_with(|| mode.clone());
        mode.local_flags -= lines;
        mode.control_chars[SpecialCharacterIndices::VMIN as usize] = 1;
        mode.control_chars[SpecialCharacterIndices::VTIME as usize] = 0;
        tcsetattr(&self.input, SetArg::TCSANOW, &mode)
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // In the background, the terminal has the mode of another job.
        if let Some(before) = &self.before
            && self.is_ours()
        {
            let _ = tcsetattr(&self.input, SetArg::TCSANOW, before);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The keys in these bytes, and the number of bytes that are left.
    fn keys(bytes: &[u8]) -> (Vec<Key>, usize) {
        let (mut left, mut keys) = (bytes, Vec::new());
        while let Some((key, len)) = first_key(left) {
            left = &left[len..];
            keys.extend(key);
        }
        (keys, left.len())
    }

    #[test]
    fn keys_are_characters_and_sequences() {
        use Key::{End, Faster, Pause, Slower, Step};
        let all = [Pause, Step, Faster, Faster, Slower, End].to_vec();
        assert_eq!(keys(b" s+=-q"), (all, 0));
        assert_eq!(keys(b"\x1b[C\x1bOCs"), ([Step; 3].to_vec(), 0));
        // Other keys, such as the left arrow, Ctrl and the right arrow, F5, and Alt with a letter.
        assert_eq!(keys(b"xQ\x1b[D\x1b[1;5C\x1b[15~\x1bx\xc3\xa4"), (vec![], 0));
    }

    #[test]
    fn a_sequence_may_come_in_parts() {
        for part in [&b"\x1b"[..], b"\x1b[", b"\x1b[1;5"] {
            assert_eq!(keys(part), (vec![], part.len()));
        }
        assert_eq!(keys(b"q\x1b["), (vec![Key::End], 2));
    }
}
