//! `sm2 top` with and without a terminal.

use std::{
    fs::File,
    io::{Read, Write},
    os::fd::{AsFd, OwnedFd},
    process::{Child, Command, Stdio},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use nix::{
    fcntl::{FcntlArg, FdFlag, fcntl},
    poll::{PollFd, PollFlags, PollTimeout, poll},
    pty::{OpenptyResult, Winsize, openpty},
    sys::{
        signal::{Signal, kill},
        termios::{LocalFlags, tcgetattr},
    },
    unistd::Pid,
};

use crate::common::{Domain, Running, listener, sm2, talker, until};

/// `sm2 top` on a terminal of its own.
struct OnTerminal {
    child: Child,
    /// The side of the person. `None` once it is closed.
    person: Option<File>,
    /// The side of the command, for reading and changing its settings.
    terminal: OwnedFd,
    /// The output so far, which a thread reads until the person closes the terminal.
    output: Arc<Mutex<Vec<u8>>>,
    closed: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

const ROWS: u16 = 20;
const COLUMNS: u16 = 100;

impl OnTerminal {
    fn start(domain: &Domain) -> Self {
        Self::with(domain, &[("TERM", "xterm")])
    }

    /// Starts it with these variables.
    fn with(domain: &Domain, variables: &[(&str, &str)]) -> Self {
        let size = Winsize {
            ws_row: ROWS,
            ws_col: COLUMNS,
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        let OpenptyResult { master, slave } = openpty(Some(&size), None).unwrap();
        // A command that has the side of the person would keep the terminal open.
        fcntl(&master, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).unwrap();
        let stdio = || Stdio::from(slave.try_clone().unwrap());
        let mut command = domain.command(&["top", "--interval", "50ms"]);
        command
            .env_remove("NO_COLOR")
            .envs(variables.iter().copied());
        let command = command.stdin(stdio()).stdout(stdio());
        let child = command.stderr(Stdio::piped()).spawn().unwrap();
        let person = File::from(master);
        let output = Arc::new(Mutex::new(Vec::new()));
        let closed = Arc::new(AtomicBool::new(false));
        let (mut from, into) = (person.try_clone().unwrap(), Arc::clone(&output));
        let end = Arc::clone(&closed);
        let reader = thread::spawn(move || {
            let mut buffer = [0; 4_096];
            while !end.load(Ordering::Relaxed) {
                let mut ready = [PollFd::new(from.as_fd(), PollFlags::POLLIN)];
                if poll(&mut ready, PollTimeout::from(10_u8)).unwrap() == 0 {
                    continue;
                }
                let Ok(len @ 1..) = from.read(&mut buffer) else {
                    break;
                };
                into.lock().unwrap().extend_from_slice(&buffer[..len]);
            }
        });
        Self {
            child,
            person: Some(person),
            terminal: slave,
            output,
            closed,
            reader: Some(reader),
        }
    }

    /// Waits until a line on the screen has this text.
    fn shows(&self, text: &str) {
        until(&format!("{text:?} is shown"), || {
            screen(&self.output.lock().unwrap()).contains(text)
        });
    }

    /// Waits until the command has sent an escape sequence.
    fn sends(&self, sequence: &str) {
        until(&format!("{sequence:?} is sent"), || {
            String::from_utf8_lossy(&self.output.lock().unwrap()).contains(sequence)
        });
    }

    fn press(&mut self, keys: &str) {
        let person = self.person.as_mut().unwrap();
        person.write_all(keys.as_bytes()).unwrap();
    }

    /// Makes the terminal as wide as `columns`, as a window that is resized.
    fn resize(&self, columns: u16) {
        let terminal = Stdio::from(self.terminal.try_clone().unwrap());
        let mut stty = Command::new("stty");
        let stty = stty.args(["cols", &columns.to_string()]).stdin(terminal);
        assert!(stty.status().unwrap().success());
    }

    /// Closes the terminal, as a window that is closed.
    fn close(&mut self) {
        self.closed.store(true, Ordering::Relaxed);
        self.reader.take().unwrap().join().unwrap();
        self.person = None;
    }

    fn code(&mut self) -> Option<i32> {
        let mut status = None;
        until("top ends", || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        status.unwrap().code()
    }

    /// Whether the terminal edits lines and echoes, as a shell needs it.
    fn is_restored(&self) -> bool {
        let flags = tcgetattr(&self.terminal).unwrap().local_flags;
        flags.contains(LocalFlags::ICANON | LocalFlags::ECHO)
    }

    fn ends(&mut self, code: i32) {
        assert_eq!(self.code(), Some(code));
        // The cursor and the previous screen are restored.
        self.sends("\x1b[?1049l");
        self.sends("\x1b[?25h");
        assert!(self.is_restored());
    }
}

/// The screen after this output. Understands only what `sm2 top` sends: text, `ESC [ row ; column H`, and `ESC [ 2 J`.
fn screen(output: &[u8]) -> String {
    let mut cells = vec![vec![' '; COLUMNS.into()]; ROWS.into()];
    let (mut row, mut column) = (0, 0);
    let text = String::from_utf8_lossy(output);
    let mut rest = text.chars();
    while let Some(c) = rest.next() {
        if c != '\x1b' {
            if let Some(cell) = cells
                .get_mut(row)
                .and_then(|it: &mut Vec<_>| it.get_mut(column))
            {
                *cell = c;
            }
            column += 1;
            continue;
        }
        // A control sequence: `[`, numbers, and a letter.
        let mut numbers = String::new();
        let end = rest
            .by_ref()
            .skip(1)
            .find(|c| match c.is_ascii_alphabetic() {
                true => true,
                false => {
                    numbers.push(*c);
                    false
                }
            });
        if end == Some('J') {
            cells = vec![vec![' '; COLUMNS.into()]; ROWS.into()];
        }
        if end == Some('H')
            && let Some((to_row, to_column)) = numbers.split_once(';')
        {
            let place = |text: &str| text.parse::<usize>().unwrap() - 1;
            (row, column) = (place(to_row), place(to_column));
        }
    }
    let lines = cells.iter().map(|line| line.iter().collect::<String>());
    lines.collect::<Vec<_>>().join("\n")
}

impl Drop for OnTerminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_person_looks_around_and_quits() {
    let domain = Domain::new();
    let (_talker, node) = talker(&domain, "scan");
    let mut top = OnTerminal::start(&domain);
    top.sends("\x1b[?1049h");
    top.shows("scan");
    assert!(!top.is_restored());
    top.press("\t");
    top.shows(&node);
    top.press("/");
    top.shows("Enter keeps it");
    top.press("nothing\r");
    top.shows("\"nothing\"");
    top.press("\x1b");
    top.shows("q quit");
    top.press("q");
    top.ends(0);
}

#[test]
fn the_terminal_is_given_back_however_it_ends() {
    let domain = Domain::new();
    let mut by_key = OnTerminal::start(&domain);
    by_key.shows("sm2 top");
    by_key.press("\x03");
    by_key.ends(0);
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let mut top = OnTerminal::start(&domain);
        top.shows("sm2 top");
        kill(Pid::from_raw(top.child.id().try_into().unwrap()), signal).unwrap();
        top.ends(0);
    }
}

/// It is closed at several moments between two frames.
#[test]
fn a_terminal_that_is_closed_ends_it() {
    let domain = Domain::new();
    for milliseconds in [0, 10, 20, 30, 40, 50] {
        let mut top = OnTerminal::start(&domain);
        top.shows("sm2 top");
        thread::sleep(Duration::from_millis(milliseconds));
        top.close();
        let code = top.code();
        let mut said = String::new();
        let mut stderr = top.child.stderr.take().unwrap();
        stderr.read_to_string(&mut said).unwrap();
        assert_eq!(code, Some(0), "{said}");
        assert!(!said.contains("panicked"), "{said}");
    }
}

#[test]
fn it_follows_the_size_of_the_terminal() {
    let domain = Domain::new();
    let mut top = OnTerminal::start(&domain);
    top.shows("/ filter");
    top.resize(40);
    // A screen of 100 columns shows all columns.
    top.shows("columns hidden");
    top.press("q");
    top.ends(0);
}

#[test]
fn rates_are_drawn_and_coloured() {
    const CYAN: &str = "\x1b[38;5;6";
    let domain = Domain::new();
    let (_talker, _) = talker(&domain, "scan");
    let mut top = OnTerminal::start(&domain);
    top.shows("TREND");
    top.shows("▇");
    top.sends(CYAN);
    top.press("q");
    top.ends(0);
    for variables in [
        [("TERM", "xterm"), ("NO_COLOR", "1")],
        [("TERM", "vt100"), ("NO_COLOR", "")],
    ] {
        let mut top = OnTerminal::with(&domain, &variables);
        top.shows("▇");
        let output = top.output.lock().unwrap().clone();
        assert!(
            !String::from_utf8_lossy(&output).contains(CYAN),
            "{variables:?}"
        );
        top.press("q");
        top.ends(0);
    }
}

#[test]
fn it_goes_on_without_a_manager_and_says_so() {
    let mut domain = Domain::new();
    let (_talker, _) = talker(&domain, "scan");
    let mut top = OnTerminal::start(&domain);
    top.shows("scan");
    domain.kill_manager();
    top.shows("the Manager is gone");
    top.press("q");
    top.ends(0);
}

#[test]
fn without_a_terminal_it_points_elsewhere() {
    let domain = Domain::new();
    domain
        .run(&["top"])
        .failed(2, &["needs a terminal", "top --once", "snapshot", "hz"]);
    let wrong = Running::start(&mut sm2(&["top", "--interval", "fast"])).finish();
    wrong.failed(2, &["--interval", "200ms"]);
}

#[test]
fn one_frame_is_printed_as_text_or_json() {
    let domain = Domain::new();
    let (_talker, one) = talker(&domain, "scan");
    let (listener, other) = listener(&domain, "scan", 1);
    listener.await_stdout("hello");
    let text = domain.run(&["top", "--once", "--interval", "100ms"]);
    assert_eq!(text.code(), 0, "{text:?}");
    let text = text.stdout();
    let starts: Vec<_> = text
        .lines()
        .map(|line| line.split(' ').next().unwrap())
        .collect();
    assert_eq!(starts, ["TOPIC", "scan", "NODE", &one, &other], "{text}");
    let mut json = serde_json::Value::Null;
    until("something is counted", || {
        json = domain.json(&["top", "--interval", "100ms"]);
        json["topics"][0]["hz"].as_f64() > Some(0.0)
            && json["nodes"][1]["in_per_s"].as_f64() > Some(0.0)
    });
    let topic = &json["topics"][0];
    assert_eq!([&topic["name"], &topic["type"]["name"]], ["scan", "bytes"]);
    assert_eq!(
        [&topic["publishers"], &topic["subscribers"], &topic["links"]],
        [1, 1, 1]
    );
    let nodes = json["nodes"].as_array().unwrap();
    assert_eq!([&nodes[0]["name"], &nodes[1]["name"]], [&*one, &*other]);
}
