//! `sm2 top` with and without a terminal.

use std::{
    fs::File,
    io::{Read, Write},
    os::fd::OwnedFd,
    process::{Child, Stdio},
    sync::{Arc, Mutex},
    thread,
};

use nix::{
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
    /// The side of the person.
    person: File,
    /// The side of the command, for reading its settings.
    terminal: OwnedFd,
    /// The output so far.
    output: Arc<Mutex<Vec<u8>>>,
}

const ROWS: u16 = 20;
const COLUMNS: u16 = 100;

impl OnTerminal {
    fn start(domain: &Domain) -> Self {
        let size = Winsize {
            ws_row: ROWS,
            ws_col: COLUMNS,
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        let OpenptyResult { master, slave } = openpty(Some(&size), None).unwrap();
        let stdio = || Stdio::from(slave.try_clone().unwrap());
        let mut command = domain.command(&["top", "--interval", "50ms"]);
        let command = command.env("TERM", "xterm").stdin(stdio()).stdout(stdio());
        let child = command.stderr(Stdio::piped()).spawn().unwrap();
        let person = File::from(master);
        let output = Arc::new(Mutex::new(Vec::new()));
        let (mut from, into) = (person.try_clone().unwrap(), Arc::clone(&output));
        // The thread ends with the terminal, which this test keeps open.
        thread::spawn(move || {
            let mut buffer = [0; 4_096];
            while let Ok(len @ 1..) = from.read(&mut buffer) {
                into.lock().unwrap().extend_from_slice(&buffer[..len]);
            }
        });
        Self {
            child,
            person,
            terminal: slave,
            output,
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
        self.person.write_all(keys.as_bytes()).unwrap();
    }

    /// Whether the terminal edits lines and echoes, as a shell needs it.
    fn is_restored(&self) -> bool {
        let flags = tcgetattr(&self.terminal).unwrap().local_flags;
        flags.contains(LocalFlags::ICANON | LocalFlags::ECHO)
    }

    fn ends(&mut self, code: i32) {
        let mut status = None;
        until("top ends", || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        assert_eq!(status.unwrap().code(), Some(code));
        // The cursor and the previous screen are restored.
        self.sends("\x1b[?1049l");
        self.sends("\x1b[?25h");
        assert!(self.is_restored());
    }
}

/// The screen after this output. Understands only what `sm2 top` sends: text, and `ESC [ row ; column H`.
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
    assert_eq!([&topic["name"], &topic["type"]], ["scan", "bytes"]);
    assert_eq!(
        [&topic["publishers"], &topic["subscribers"], &topic["links"]],
        [1, 1, 1]
    );
    let nodes = json["nodes"].as_array().unwrap();
    assert_eq!([&nodes[0]["name"], &nodes[1]["name"]], [&*one, &*other]);
}
