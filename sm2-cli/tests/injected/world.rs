//! A domain of shipped programs, and messages from one to another.

use std::{
    fs,
    path::{Path, PathBuf},
};

use nix::sys::signal::Signal;
use sm2_tests::{
    domain::TempDomain,
    eventually,
    process::{Exit, Finished, Process},
};

use crate::{
    programs::{self, End, done, end_of, sm2},
    strace::Victim,
};

/// How often the work of a domain is tried after a fault of its Manager.
const TRIES: usize = 3;

/// A domain, and a folder with messages.
pub(crate) struct World {
    pub(crate) domain: TempDomain,
    manager: Process,
    messages: Vec<String>,
    /// How many folders with received messages there were.
    folders: usize,
}

/// Where a subscriber writes messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum To {
    Output,
    Files,
}

impl World {
    /// Starts a domain without a fault.
    pub(crate) fn start() -> Self {
        Self::start_with(&Victim::NONE)
    }

    /// Starts a domain whose Manager is the victim. If it fails, another one starts.
    pub(crate) fn start_with(victim: &Victim) -> Self {
        let domain = TempDomain::new();
        let messages: Vec<_> = [40, 100_000, 3_000]
            .map(|len| format!("{len} ").repeat(len / 4))
            .into();
        let folder = domain.folder().join("messages");
        fs::create_dir(&folder).expect("a folder");
        for (number, message) in messages.iter().enumerate() {
            fs::write(folder.join(number.to_string()), message).expect("a file");
        }
        let manager = serving(&domain, victim, &[]).unwrap_or_else(|| {
            serving(&domain, &Victim::NONE, &[]).expect("a Manager without a fault")
        });
        Self {
            domain,
            manager,
            messages,
            folders: 0,
        }
    }

    /// A command of `sm2` in this domain.
    pub(crate) fn command(&self, arguments: &[&str]) -> std::process::Command {
        let mut command = sm2(arguments);
        command.arg("--socket").arg(self.domain.socket());
        command
    }

    /// Works through [`exchange`](Self::exchange) without a fault until it succeeds.
    #[track_caller]
    pub(crate) fn exchange_at_last(&mut self, to: To) {
        let is_done = (0..TRIES).any(|_| self.exchange([&Victim::NONE; 2], to) == End::Done);
        assert!(is_done, "messages do not arrive after a fault");
    }

    /// Sends all messages from a publisher to a subscriber. [`End::Failed`] if one of them has failed, or if the
    /// publisher says that messages are missing.
    #[track_caller]
    pub(crate) fn exchange(&mut self, [talker, listener]: [&Victim; 2], to: To) -> End {
        let count = self.messages.len().to_string();
        let mut echo = self.command(&["topic", "echo", "topic", "--reliable", "--count", &count]);
        let folder = self.next_folder();
        match to {
            To::Output => echo.arg("--json"),
            To::Files => echo.arg("--to-dir").arg(&folder),
        };
        let mut publish = self.command(&["topic", "pub", "topic", "--reliable"]);
        publish
            .arg("--from")
            .arg(self.domain.folder().join("messages"));
        let mut listener = listener.start(echo);
        let mut talker = talker.start(publish);
        // The other one would wait for the one that fails.
        eventually("the end of a program", || {
            listener.has_ended() || talker.has_ended()
        });
        if !talker.has_ended() && listener.wait() != Exit::Status(0) {
            talker.signal(Signal::SIGINT);
        }
        let (talked, said) = end_of(&mut talker);
        let published = Published::of(&said);
        let all = self.messages.len() as u64;
        let complete = talked == End::Done && published.is_none_or(|it| it.delivered == all);
        if !complete {
            listener.signal(Signal::SIGINT);
        }
        let (listened, heard) = end_of(&mut listener);
        let received = match to {
            To::Output => self.received_lines(&heard),
            To::Files => self.received_files(&folder),
        };
        if let Some(published) = published {
            published.adds_up(all);
        }
        if let (Some(published), End::Done) = (published, listened) {
            assert!(
                received >= published.delivered,
                "{published:?}, {received} received"
            );
        }
        match complete && listened == End::Done {
            true => {
                assert_eq!(received, all, "{}", heard.stderr);
                End::Done
            }
            false => End::Failed,
        }
    }

    fn next_folder(&mut self) -> PathBuf {
        self.folders += 1;
        self.domain
            .folder()
            .join(format!("received-{}", self.folders))
    }

    /// Checks the messages that a subscriber has printed, and returns their number.
    #[track_caller]
    fn received_lines(&self, heard: &Finished) -> u64 {
        for line in &heard.lines {
            let message: serde_json::Value = serde_json::from_str(line).expect("JSON");
            let text = message["text"].as_str().expect("a text");
            assert!(
                self.messages.iter().any(|it| it == text),
                "a damaged message"
            );
        }
        gapless(heard)
    }

    /// Checks the files that a subscriber has written, removes them, and returns their number.
    #[track_caller]
    fn received_files(&self, folder: &Path) -> u64 {
        let Ok(entries) = fs::read_dir(folder) else {
            return 0;
        };
        let mut names: Vec<_> = entries.map(|it| it.expect("an entry").path()).collect();
        names.sort();
        for (path, message) in names.iter().zip(&self.messages) {
            assert!(
                !path.to_string_lossy().ends_with(".part"),
                "{path:?} is left"
            );
            assert!(
                fs::read(path).expect("a file") == message.as_bytes(),
                "{path:?} is damaged"
            );
        }
        assert!(names.len() <= self.messages.len(), "{names:?}");
        fs::remove_dir_all(folder).expect("a folder");
        names.len() as u64
    }

    /// Starts a Manager that takes the place of the one that serves. `None` if it failed, and said why.
    #[track_caller]
    pub(crate) fn successor(&self, victim: &Victim) -> Option<Process> {
        serving(&self.domain, victim, &["--replace"])
    }

    /// The Manager from now on. The one before must have ended well.
    #[track_caller]
    pub(crate) fn adopt(&mut self, manager: Process) {
        done(&mut self.manager);
        self.manager = manager;
    }

    /// Ends the domain: its Manager still serves. Returns the files that are left. `managers` are the victims among its
    /// Managers.
    #[track_caller]
    pub(crate) fn end(mut self, managers: &[&Victim]) -> Vec<String> {
        self.end_manager();
        if managers.iter().any(|it| it.fails("unlink")) {
            // The next Manager removes what a Manager could not remove.
            let next = serving(&self.domain, &Victim::NONE, &[]);
            self.manager = next.expect("a Manager without a fault");
            self.end_manager();
        }
        self.domain.files()
    }

    #[track_caller]
    fn end_manager(&mut self) {
        assert!(!self.manager.has_ended(), "{}", self.manager.stderr());
        self.manager.signal(Signal::SIGTERM);
        done(&mut self.manager);
    }
}

/// Starts a Manager, and waits until it serves. `None` if it failed, and said why.
#[track_caller]
pub(crate) fn serving(domain: &TempDomain, victim: &Victim, options: &[&str]) -> Option<Process> {
    let mut command = programs::manager(&domain.socket());
    command.args(options);
    serves(victim.start(command), "serving")
}

/// Waits until a program says in its log that it serves. `None` if it failed, and said why.
#[track_caller]
pub(crate) fn serves(mut process: Process, word: &str) -> Option<Process> {
    eventually(word, || {
        process.stderr().contains(word) || process.has_ended()
    });
    match process.has_ended() {
        false => Some(process),
        true => {
            let (end, finished) = end_of(&mut process);
            assert_eq!(end, End::Failed, "{}", finished.stderr);
            None
        }
    }
}

/// The summary of a publisher.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Published {
    pub(crate) messages: u64,
    pub(crate) delivered: u64,
    unheard: u64,
    in_flight: u64,
    dropped: u64,
}

impl Published {
    /// `None` if the publisher failed before its end.
    pub(crate) fn of(talker: &Finished) -> Option<Self> {
        let summary = (talker.stderr.lines()).find_map(|it| it.strip_prefix("published "))?;
        let before = |words: &str| {
            let number = summary.split(words).next().filter(|it| *it != summary)?;
            number.rsplit(' ').next()?.parse().ok()
        };
        Some(Self {
            messages: summary.split(' ').next()?.parse().ok()?,
            delivered: before(" delivered")?,
            unheard: before(" without a subscriber").unwrap_or(0),
            in_flight: before(" still in flight").unwrap_or(0),
            dropped: before(" dropped")?,
        })
    }

    /// How many messages are missing, as the publisher says.
    pub(crate) const fn missing(&self) -> u64 {
        self.unheard + self.in_flight + self.dropped
    }

    /// Checks that all messages for one subscriber have a fate.
    #[track_caller]
    fn adds_up(&self, all: u64) {
        let told = self.delivered + self.missing();
        assert!(self.messages <= all && told >= self.messages, "{self:?}");
    }
}

/// Checks that the printed messages have consecutive numbers, but for those that the subscriber says it has lost.
/// Returns how many there are.
#[track_caller]
pub(crate) fn gapless(heard: &Finished) -> u64 {
    let mut last = None;
    for line in &heard.lines {
        let message: serde_json::Value = serde_json::from_str(line).expect("JSON");
        let number = |key: &str| message[key].as_u64().expect("a number");
        let (sequence, lost) = (number("sequence"), number("lost"));
        if let Some(last) = last {
            assert_eq!(sequence, last + 1 + lost, "an uncounted loss");
        }
        last = Some(sequence);
    }
    heard.lines.len() as u64
}
