//! A node in a process of its own. It carries out the commands of a test, one at a time, and drives
//! its sockets between them. `src/bin/sm2-test-actor/node/commands.rs` lists the commands.

use std::{path::Path, process::Command};

use nix::sys::signal::Signal;
use sm2_proto::link::Fate;

use crate::{
    census::Census,
    process::{Exit, Process, actor},
};

/// A node of the library `sm2-node` that carries out commands.
#[derive(Debug)]
pub struct Actor {
    process: Process,
    name: String,
}

impl Actor {
    /// A node that has its session with the Manager.
    #[must_use]
    #[track_caller]
    pub fn start(socket: &Path, name: &str) -> Self {
        let actor = Self::launch(socket, name, &[]);
        assert_eq!(actor.process.expect_line(), "ready", "{name}");
        actor
    }

    /// A node that is about to greet, with these options of the `node` actor. Its first
    /// [answer](Self::answer) is `ready` or `failed …`.
    #[must_use]
    pub fn launch(socket: &Path, name: &str, options: &[&str]) -> Self {
        let mut command = actor("node");
        command.args(options);
        Self::spawn(command, socket, name)
    }

    /// As [`start`](Self::start), run by this command, which names the role.
    #[must_use]
    #[track_caller]
    pub fn start_as(command: Command, socket: &Path, name: &str) -> Self {
        let actor = Self::spawn(command, socket, name);
        assert_eq!(actor.process.expect_line(), "ready", "{name}");
        actor
    }

    fn spawn(mut command: Command, socket: &Path, name: &str) -> Self {
        command.arg("--socket").arg(socket).args(["--name", name]);
        Self {
            process: Process::start(command),
            name: name.to_owned(),
        }
    }

    /// The name of the node.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its process id.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.process.pid()
    }

    /// The descriptors and mappings that the process has now.
    #[must_use]
    pub fn census(&self) -> Census {
        self.process.census()
    }

    /// As [`census`](Self::census), while none of its threads runs.
    #[must_use]
    #[track_caller]
    pub fn census_when_idle(&self) -> Census {
        self.process.census_when_idle()
    }

    /// Sends a command; [`answer`](Self::answer) returns its answer.
    pub fn say(&mut self, command: &str) {
        self.process.say(command);
    }

    /// The answer to the oldest command that has none.
    #[track_caller]
    pub fn answer(&self) -> String {
        self.process.expect_line()
    }

    /// Sends a command, and returns its answer.
    #[track_caller]
    pub fn ask(&mut self, command: &str) -> String {
        self.say(command);
        self.answer()
    }

    /// Sends a command that must succeed, and returns the answer behind `ok`.
    #[track_caller]
    pub fn tell(&mut self, command: &str) -> String {
        let answer = self.ask(command);
        let Some(rest) = answer.strip_prefix("ok") else {
            panic!("{}: {command}: {answer}", self.name);
        };
        rest.trim_start().to_owned()
    }

    /// Sends it a signal.
    pub fn signal(&mut self, signal: Signal) {
        self.process.signal(signal);
    }

    /// Stops the process; returns when it has stopped.
    #[track_caller]
    pub fn stop(&mut self) {
        self.process.stop();
    }

    /// Continues the stopped process.
    pub fn resume(&mut self) {
        self.process.resume();
    }

    /// Kills it (SIGKILL) and waits for its end.
    pub fn kill(&mut self) {
        self.process.kill();
    }

    /// Waits for its end.
    #[track_caller]
    pub fn wait(&mut self) -> Exit {
        self.process.wait()
    }

    /// The standard error of the process so far.
    #[must_use]
    pub fn stderr(&self) -> String {
        self.process.stderr()
    }
}

/// The number after `key=` in an answer.
#[must_use]
#[track_caller]
pub fn number(answer: &str, key: &str) -> u64 {
    let words = answer.split_whitespace();
    let mut values = words.filter_map(|word| word.strip_prefix(key)?.strip_prefix('='));
    let value = values.next().and_then(|value| value.parse().ok());
    value.unwrap_or_else(|| panic!("no number {key} in {answer:?}"))
}

/// The fates of the messages of one link, counted by its sender (SM2-QOS-006).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Counted {
    /// The node at the other end.
    pub peer: String,
    /// Whether the link is open.
    pub open: bool,
    /// Messages that were to be sent.
    pub offered: u64,
    /// Messages that the application gave back.
    pub delivered: u64,
    /// Messages that were lost, whatever the reason.
    pub dropped: u64,
    /// Messages that are neither delivered nor dropped.
    pub in_flight: u64,
    text: String,
}

impl Counted {
    fn parse(text: &str) -> Self {
        let of = |key| number(text, key);
        let mut words = text.split_whitespace();
        let peer = words.find_map(|word| word.strip_prefix("peer="));
        Self {
            peer: peer.expect("a peer").to_owned(),
            open: text.contains("open=true"),
            offered: of("offered"),
            delivered: of("delivered"),
            dropped: (Fate::ALL.into_iter().filter(|it| it.is_drop()))
                .map(|fate| of(fate.as_str()))
                .sum(),
            in_flight: of("in_flight"),
            text: text.to_owned(),
        }
    }

    /// The number of this kind alone, such as [`Fate::as_str`].
    #[must_use]
    #[track_caller]
    pub fn of(&self, kind: &str) -> u64 {
        number(&self.text, kind)
    }

    /// Asserts that offered is the sum of delivered, dropped and in flight.
    #[track_caller]
    pub fn adds_up(&self) {
        let sum = self.delivered + self.dropped + self.in_flight;
        assert_eq!(self.offered, sum, "{}", self.text);
    }
}

impl Actor {
    /// The counters of all links of a publisher or client; each adds up.
    #[track_caller]
    pub fn counted(&mut self, key: &str) -> Vec<Counted> {
        let answer = self.tell(&format!("counters {key}"));
        let links = answer.split('|').skip(1).map(Counted::parse);
        let links: Vec<Counted> = links.collect();
        links.iter().for_each(Counted::adds_up);
        links
    }

    /// The counters of the one link with this node.
    #[track_caller]
    pub fn counted_with(&mut self, key: &str, peer: &str) -> Counted {
        let links = self.counted(key);
        let mut with = links.iter().filter(|link| link.peer == peer);
        let link = with.next().cloned();
        link.unwrap_or_else(|| panic!("no link of {key} with {peer}: {links:?}"))
    }
}
