//! The arguments whose values the domain has.

use std::ffi::OsStr;

use clap::Command;
use clap_complete::{ArgValueCompleter, CompletionCandidate, engine::ValueCompleter};

use super::domain::{Line, Values, candidates};

/// The arguments: the words of the command, the identifiers of its arguments, and their values.
const ARGUMENTS: &[(&[&str], &[&str], Values)] = &[
    (&["topic", "info"], &["topic"], Values::Topics),
    (&["topic", "pub"], &["topic"], Values::Topics),
    (&["topic", "echo"], &["topic"], Values::Topics),
    (&["topic", "hz"], &["topic"], Values::Topics),
    (&["topic", "bw"], &["topic"], Values::Topics),
    (&["topic", "delay"], &["topic"], Values::Topics),
    (&["topic", "loss"], &["topic"], Values::Topics),
    (&["service", "info"], &["service"], Values::Services),
    (&["service", "call"], &["service"], Values::Services),
    (&["node", "info"], &["node"], Values::Nodes),
    (&["param", "list"], &["node"], Values::NodesWithParameters),
    (&["param", "get"], &["node"], Values::NodesWithParameters),
    (&["param", "get"], &["name"], Values::Parameters),
    (&["param", "set"], &["node"], Values::NodesWithParameters),
    (&["param", "set"], &["values"], Values::Assignments),
    (
        &["param", "describe"],
        &["node"],
        Values::NodesWithParameters,
    ),
    (&["param", "describe"], &["names"], Values::Parameters),
    (&["param", "dump"], &["node"], Values::NodesWithParameters),
    (&["param", "load"], &["node"], Values::NodesWithParameters),
    (&["param", "watch"], &["node"], Values::NodesWithParameters),
    (&["param", "watch"], &["names"], Values::Parameters),
    (&["why"], &["one", "other"], Values::Interfaces),
    (&["wait"], &["expressions"], Values::Conditions),
    (&["foxglove"], &["arguments"], Values::Topics),
    (
        &["record"],
        &["topics", "exclude", "reliable", "on_message"],
        Values::Topics,
    ),
    (&["record"], &["on_lost"], Values::Nodes),
    (&["record", "trigger"], &["service"], Values::Services),
    (&["play", "control"], &["service"], Values::Services),
    (&["gateway", "ask"], &["name"], Values::Topics),
];

/// The tree of all commands, with the values of their arguments.
pub(super) fn with_values(root: Command) -> Command {
    ARGUMENTS.iter().fold(root, |root, (words, ids, values)| {
        with(root, words, ids, *values)
    })
}

/// A command whose arguments at these words have values.
fn with(command: Command, words: &[&str], ids: &[&str], values: Values) -> Command {
    match words {
        // `mut_arg` would move an argument behind all others.
        [] => command.mut_args(|it| match ids.contains(&it.get_id().as_str()) {
            true => it.add(ArgValueCompleter::new(values)),
            false => it,
        }),
        [first, rest @ ..] => command.mut_subcommand(first, |it| with(it, rest, ids, values)),
    }
}

impl ValueCompleter for Values {
    fn complete(&self, current: &OsStr) -> Vec<CompletionCandidate> {
        self.complete_at(0, current)
    }

    fn complete_at(&self, at: usize, current: &OsStr) -> Vec<CompletionCandidate> {
        // Only a parameter, not its new value.
        if *self == Self::Assignments && !at.is_multiple_of(2) {
            return Vec::new();
        }
        let Some(current) = current.to_str() else {
            return Vec::new();
        };
        candidates(*self, &Line::of_process(), current)
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::command::Cli;

    fn command() -> Command {
        with_values(Cli::command())
    }

    /// The names of values that stand for something in a domain.
    const OF_DOMAIN: [&str; 5] = ["NODE", "TOPIC", "TOPIC|GLOB", "EXPRESSION", "SERVICE"];

    /// Not of the running domain: those of a policy file, and the topics of bags.
    const OTHERS: [&str; 4] = ["policy explain", "bag filter", "bag cat", "play"];

    fn visit(command: &Command, words: &str, missing: &mut Vec<String>) {
        for argument in command.get_arguments() {
            let names = argument.get_value_names().unwrap_or_default();
            let is_of_domain = names.iter().any(|it| OF_DOMAIN.contains(&it.as_str()));
            let is_other = OTHERS.contains(&words);
            if is_of_domain && !is_other && argument.get::<ArgValueCompleter>().is_none() {
                missing.push(format!("{words} {}", argument.get_id()));
            }
        }
        for it in command.get_subcommands() {
            let words = format!("{words} {}", it.get_name());
            visit(it, words.trim(), missing);
        }
    }

    fn has_values(command: &Command, words: &[&str], id: &str) -> bool {
        let command = words
            .iter()
            .try_fold(command, |it, word| it.find_subcommand(word));
        let mut all = command.into_iter().flat_map(Command::get_arguments);
        all.any(|it| it.get_id() == id && it.get::<ArgValueCompleter>().is_some())
    }

    #[test]
    fn the_arguments_exist() {
        let mut command = command();
        for (words, ids, _) in ARGUMENTS {
            for id in *ids {
                assert!(has_values(&command, words, id), "{words:?} {id}");
            }
        }
        // It asserts the order of arguments.
        command.build();
    }

    #[test]
    fn each_argument_that_names_something_of_a_domain_is_completed() {
        let mut missing = Vec::new();
        visit(&command(), "", &mut missing);
        assert_eq!(missing, Vec::<String>::new());
    }
}
