//! The terminal in raw mode, restored however the command ends.

use std::{
    io::{self, Stdout},
    os::fd::AsFd,
    panic,
    sync::Once,
    time::Duration,
};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use ratatui::{
    Frame, Terminal,
    backend::CrosstermBackend,
    crossterm::{
        cursor::Show,
        event::{self, Event, KeyEvent, KeyEventKind},
        execute,
        terminal::{EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode},
    },
};

/// Whether the terminal is closed. All operations on it then fail, with errors of several kinds.
pub(super) fn is_closed() -> bool {
    let stdin = io::stdin();
    let mut terminal = [PollFd::new(stdin.as_fd(), PollFlags::empty())];
    let polled = poll(&mut terminal, PollTimeout::ZERO);
    polled.is_ok() && terminal[0].any() == Some(true)
}

/// The whole terminal. Dropping it restores the terminal.
pub(super) struct Screen(Terminal<CrosstermBackend<Stdout>>);

impl Screen {
    /// Takes over the terminal. A panic restores it before the panic message is printed.
    ///
    /// # Errors
    ///
    /// The I/O error of the terminal.
    pub(super) fn open() -> io::Result<Self> {
        static HOOK: Once = Once::new();
        HOOK.call_once(|| {
            let before = panic::take_hook();
            panic::set_hook(Box::new(move |info| {
                restore();
                before(info);
            }));
        });
        enable_raw_mode()?;
        let opened = execute!(io::stdout(), EnterAlternateScreen)
            .and_then(|()| Terminal::new(CrosstermBackend::new(io::stdout())));
        if opened.is_err() {
            restore();
        }
        opened.map(Self)
    }

    /// Draws the differences to the last frame, in the current size of the terminal.
    ///
    /// # Errors
    ///
    /// The I/O error of the terminal.
    pub(super) fn draw(&mut self, draw: impl FnOnce(&mut Frame<'_>)) -> io::Result<()> {
        self.0.draw(draw).map(drop)
    }

    /// The keys that were pressed since the last call.
    ///
    /// # Errors
    ///
    /// The I/O error of the terminal.
    pub(super) fn keys(&mut self) -> io::Result<Vec<KeyEvent>> {
        let mut keys = Vec::new();
        while event::poll(Duration::ZERO)? {
            if let Event::Key(key) = event::read()?
                && key.kind != KeyEventKind::Release
            {
                keys.push(key);
            }
        }
        Ok(keys)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        restore();
    }
}

/// Restores the terminal. Errors are ignored: no other step could repair the terminal.
fn restore() {
    let _ = disable_raw_mode();
    let _ = execute!(io::stdout(), LeaveAlternateScreen, Show);
}

#[cfg(test)]
mod tests {
    use std::{
        env,
        fs::File,
        io::Read,
        process::{Command, Stdio},
    };

    use nix::{pty::openpty, sys::termios::tcgetattr};
    use sm2_test_support::until;

    use super::*;

    /// The test starts itself with this variable, on a terminal.
    const PANICS: &str = "SM2_TEST_PANICS_ON_THE_SCREEN";

    #[test]
    fn a_panic_gives_the_terminal_back_before_its_message() {
        if env::var_os(PANICS).is_some() {
            let _screen = Screen::open().unwrap();
            panic!("the reason");
        }
        let pty = openpty(None, None).unwrap();
        let before = tcgetattr(&pty.slave).unwrap();
        let stdio = || Stdio::from(pty.slave.try_clone().unwrap());
        let path = concat!(
            module_path!(),
            "::a_panic_gives_the_terminal_back_before_its_message"
        );
        let (_, name) = path.split_once("::").unwrap();
        let mut command = Command::new(env::current_exe().unwrap());
        command
            .args(["--exact", name, "--nocapture"])
            .env(PANICS, "1");
        command.stdin(stdio()).stdout(stdio()).stderr(stdio());
        let mut child = command.spawn().unwrap();
        // It keeps copies of the descriptors.
        drop(command);
        until("the process ends", || child.try_wait().unwrap().is_some());
        assert_eq!(tcgetattr(&pty.slave).unwrap(), before);
        drop(pty.slave);
        let mut said = Vec::new();
        // At the end of what a closed terminal has shown is an error.
        let _ = File::from(pty.master).read_to_end(&mut said);
        let said = String::from_utf8_lossy(&said);
        let at = |text: &str| {
            said.find(text)
                .unwrap_or_else(|| panic!("{text:?} in {said}"))
        };
        assert!(at("\x1b[?1049h") < at("\x1b[?1049l"));
        assert!(at("\x1b[?1049l") < at("the reason"));
    }
}
