//! The lines of `sm2 up`: states and logs, with the names of the programs in one column, or as JSON.
//!
//! A thread writes them. A terminal that is stopped, a slow reader or a full disk therefore does not stop the programs:
//! lines that do not fit into the queue are dropped and counted.

use std::{
    io::{self, Write},
    sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender, TrySendError},
    thread,
};

use anstream::{AutoStream, ColorChoice, adapter::strip_str};
use anstyle::{AnsiColor, Style};
use serde::Serialize;
use sm2_io::clock;
use sm2_proto::{Instant, text::Counted};

use super::{
    limits::{FLUSH_TIMEOUT, QUEUED_LINES},
    process::Exit,
};
use crate::{error::CliError, output::Output, printable::printable};

/// The colours of the names, in turn.
const COLOURS: [AnsiColor; 6] = [
    AnsiColor::Cyan,
    AnsiColor::Green,
    AnsiColor::Yellow,
    AnsiColor::Blue,
    AnsiColor::Magenta,
    AnsiColor::BrightCyan,
];

/// The name of `sm2 up` itself among the programs.
const ITSELF: &str = "sm2";

/// The kind of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Kind {
    /// The program has printed a line.
    Log,
    /// The program waits for its conditions.
    Waiting,
    /// The program runs.
    Started,
    /// The program could not be started.
    NotStarted,
    /// The program has ended.
    Exited,
    /// The program will be started again.
    Restarting,
    /// The program has failed, and will not be started again.
    Failed,
    /// The program gets SIGTERM.
    Stopping,
    /// The program gets SIGKILL.
    Killing,
    /// News of the domain.
    Domain,
    /// Lines were dropped, because they were not read.
    Dropped,
    /// All programs have ended.
    Done,
}

/// An event, as `--json` prints it.
#[derive(Debug, Serialize)]
struct Event {
    /// The time since the start of `sm2 up`.
    elapsed_s: f64,
    event: Kind,
    /// `None` for `sm2 up` itself.
    program: Option<String>,
    text: String,
    pid: Option<i32>,
    /// The exit status of a program.
    status: Option<i32>,
    /// The number of the signal that ended a program.
    signal: Option<i32>,
    /// The position of the program in the file.
    #[serde(skip)]
    at: Option<usize>,
}

impl Event {
    /// An event of `sm2 up`, without its text.
    const fn own(elapsed_s: f64, event: Kind) -> Self {
        Self {
            elapsed_s,
            event,
            program: None,
            text: String::new(),
            pid: None,
            status: None,
            signal: None,
            at: None,
        }
    }
}

/// The queue of the thread that writes.
pub(super) struct Show {
    start: Instant,
    names: Vec<String>,
    queue: Option<SyncSender<Event>>,
    /// Gets the result of the thread.
    written: Receiver<Result<(), CliError>>,
    dropped: u64,
}

/// How lines are written.
struct Form {
    is_json: bool,
    has_colours: bool,
    width: usize,
}

impl Show {
    /// Starts the thread. `names` are those of the programs.
    ///
    /// # Errors
    ///
    /// [`CliError::System`].
    pub(super) fn start(names: Vec<String>, is_json: bool) -> Result<Self, CliError> {
        let widths = names.iter().map(String::len).chain([ITSELF.len()]);
        let form = Form {
            is_json,
            has_colours: AutoStream::choice(&io::stdout()) != ColorChoice::Never,
            width: widths.max().unwrap_or(0),
        };
        let (queue, events) = mpsc::sync_channel(QUEUED_LINES);
        let (result, written) = mpsc::channel();
        let write = move || {
            // Nobody reads the result after the timeout.
            let _ = result.send(form.write_all(&events));
        };
        let thread = thread::Builder::new().name("sm2-up-output".into());
        (thread.spawn(write)).map_err(CliError::system("start a thread"))?;
        Ok(Self {
            start: clock::now(),
            names,
            queue: Some(queue),
            written,
            dropped: 0,
        })
    }

    /// Shows an event of the program with this position.
    pub(super) fn program(&mut self, at: usize, event: Kind, text: impl Into<String>) {
        self.event(Some(at), event, text.into(), None, None);
    }

    /// Shows that a program has started.
    pub(super) fn started(&mut self, at: usize, pid: i32, text: String) {
        self.event(Some(at), Kind::Started, text, Some(pid), None);
    }

    /// Shows that a program has ended.
    pub(super) fn exited(&mut self, at: usize, pid: i32, exit: Exit, text: String) {
        self.event(Some(at), Kind::Exited, text, Some(pid), Some(exit));
    }

    /// Shows an event of `sm2 up`.
    pub(super) fn own(&mut self, event: Kind, text: impl Into<String>) {
        self.event(None, event, text.into(), None, None);
    }

    fn event(
        &mut self,
        at: Option<usize>,
        event: Kind,
        text: String,
        pid: Option<i32>,
        exit: Option<Exit>,
    ) {
        if self.dropped > 0 && event != Kind::Dropped {
            let lines = Counted::new(self.dropped, "line");
            let text = format!("{lines} dropped: the output is slower than the programs");
            let dropped = std::mem::take(&mut self.dropped);
            self.event(None, Kind::Dropped, text, None, None);
            // The line about them is no line of theirs.
            self.dropped = if self.dropped > 0 { dropped } else { 0 };
        }
        let elapsed = clock::now().since(self.start);
        let event = Event {
            program: at.and_then(|at| self.names.get(at).cloned()),
            text,
            pid,
            status: match exit {
                Some(Exit::Status(status)) => Some(status),
                _ => None,
            },
            signal: match exit {
                Some(Exit::Signal(signal)) => Some(signal as i32),
                _ => None,
            },
            at,
            ..Event::own(elapsed.as_millis() as f64 / 1e3, event)
        };
        let sent = self.queue.as_ref().map(|queue| queue.try_send(event));
        if let Some(Err(TrySendError::Full(_))) = sent {
            self.dropped += 1;
        }
    }

    /// Waits a moment for the last lines.
    ///
    /// # Errors
    ///
    /// [`CliError::Output`] if the last lines could not be written.
    pub(super) fn finish(mut self) -> Result<(), CliError> {
        self.queue = None;
        match self.written.recv_timeout(FLUSH_TIMEOUT) {
            Ok(result) => result,
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => Ok(()),
        }
    }
}

impl Form {
    /// Writes all events. A line that cannot be written is lost, but not those after it: a disk may have room again.
    fn write_all(&self, events: &Receiver<Event>) -> Result<(), CliError> {
        let mut out = Output::new();
        let mut lost = 0;
        let mut result = Ok(());
        while let Ok(event) = events.recv() {
            if lost > 0 {
                // If this is not written either, all of it is said later.
                let mut text = Event::own(event.elapsed_s, Kind::Dropped);
                text.text = format!(
                    "up to {} lost: the output failed",
                    Counted::new(lost, "line")
                );
                if self.write(&mut out, &text).is_ok() && out.flush().is_ok() {
                    lost = 0;
                }
            }
            result = self.write(&mut out, &event).and_then(|()| out.flush());
            lost += u64::from(result.is_err());
        }
        result
    }

    fn write(&self, out: &mut Output, event: &Event) -> Result<(), CliError> {
        if self.is_json {
            return out.json(event);
        }
        let (style, is_log) = (self.style(event), event.event == Kind::Log);
        let name = event.program.as_deref().unwrap_or(ITSELF);
        let (mark, width) = (if is_log { '|' } else { '*' }, self.width);
        // The colours of a program that does not know its reader.
        let text = strip_str(&event.text).to_string();
        let text = printable(&text);
        out.write(|out| writeln!(out, "{style}{name:<width$} {mark}{style:#} {text}"))
    }

    fn style(&self, event: &Event) -> Style {
        let colour = match event.event {
            _ if !self.has_colours => return Style::new(),
            Kind::Failed | Kind::NotStarted | Kind::Killing | Kind::Dropped => AnsiColor::Red,
            _ => match event.at {
                Some(at) => COLOURS[at % COLOURS.len()],
                None => return Style::new(),
            },
        };
        colour.on_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropped_lines_are_counted_before_the_next_line() {
        let (queue, events) = mpsc::sync_channel(2);
        let mut show = Show {
            start: clock::now(),
            names: vec!["camera".into()],
            queue: Some(queue),
            written: mpsc::channel().1,
            dropped: 0,
        };
        let read = || Vec::from_iter(events.try_iter().map(|it| (it.event, it.text)));
        let line = |text: &str| (Kind::Log, text.to_owned());
        for text in ["1", "2", "3", "4", "5"] {
            show.program(0, Kind::Log, text);
        }
        assert_eq!(read(), [line("1"), line("2")]);
        show.program(0, Kind::Log, "6");
        let dropped = "3 lines dropped: the output is slower than the programs";
        let dropped = (Kind::Dropped, dropped.to_owned());
        assert_eq!(read(), [dropped, line("6")]);
        // No further line was dropped.
        show.program(0, Kind::Log, "7");
        assert_eq!(read(), [line("7")]);
    }
}
