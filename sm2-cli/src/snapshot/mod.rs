//! `sm2 snapshot`: the whole domain at one revision, or its changes from there on.

pub(crate) mod document;
pub(crate) mod gateways;
mod named_item;

use std::{collections::BTreeMap, os::fd::AsFd};

use clap::Args;
use serde::Serialize;
use sm2_proto::{
    control::{Change, Key},
    domain::Domain as Mirror,
};

pub(crate) use self::named_item::reason_text;
use self::{document::Document, named_item::NamedItem};
use crate::{
    args::Domain, connect::CommandNode, ended::Ended, error::CliError, follow::Follow, limits,
    observation::Observation, output::Output, view::View, wait::For,
};

/// `sm2 snapshot`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// Print everything that exists, and then every change, one per line
    #[arg(long)]
    watch: bool,
    /// Print one JSON object; with --watch, one for each change
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    limits: limits::Shown,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
The first lines name the ends of links that take nothing although messages wait, or hold all samples that
they can hold, the deadlines that are being missed, and pairs that match and are not linked. The tables have
links with their counters, interfaces (refused ones too), nodes, the reports of gateways about their peers, and
the limits of the Manager that are used by 80 % or more; --limits and --json show all of them. A gateway that
does not answer within a second is marked. Everything is from one revision of the domain; counters are read a
moment later, and again after a second if messages were lost. With --watch,
`+` marks an item that is new or has changed, and `-` one that is gone. When another Manager takes over,
the differences are printed.

Exit status: 0 done or --watch was ended by Ctrl-C, 1 failed, 2 wrong usage.

Examples:
  sm2 snapshot
  sm2 snapshot --json | jq '.links[] | select(.counters.overwritten > 0)'
  sm2 snapshot --json | jq .troubles.not_taking
  sm2 snapshot --json | jq '.gateways[].report.peers[] | {name, messages, denied}'
  sm2 snapshot --watch";

/// Runs the command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.domain, "snapshot")?;
    if arguments.watch {
        return watch(arguments, &command_node);
    }
    let domain = command_node.snapshot()?;
    let nodes = domain.nodes().map(|node| node.node).collect();
    let wait = |until| Ok(!command_node.pause(until)?);
    let observation = Observation::make(&command_node.node, &domain, &nodes, wait)?;
    command_node.fail_if_stopped()?;
    let gateways = gateways::ask(&command_node, &domain);
    let document = Document::new(
        &command_node,
        &View::new(&domain),
        observation.readings(),
        gateways,
    );
    Output::new().answer(arguments.json, &document, |out| {
        document.print(out, arguments.limits)
    })?;
    Ok(Ended::Done)
}

/// A change as a line of JSON.
#[derive(Serialize)]
struct Line<'a> {
    /// The revision of the domain after this change and all others of the same time.
    revision: u64,
    /// `set` or `removed`.
    change: &'static str,
    #[serde(flatten)]
    named: &'a NamedItem,
}

fn watch(arguments: &Arguments, command_node: &CommandNode) -> Result<Ended, CliError> {
    let mut follow = Follow::new(command_node, arguments.domain.connect_timeout)?;
    let mut writer = Writer {
        json: arguments.json,
        out: Output::new(),
        known: BTreeMap::new(),
    };
    let all = follow.domain().items().cloned();
    let all = all.map(|item| Change::Set { item }).collect::<Vec<_>>();
    writer.write(command_node, follow.domain(), &all)?;
    loop {
        let woken = follow.wait(&[(writer.out.as_fd(), For::Hangup)], None)?;
        writer.write(command_node, follow.domain(), &woken.changes)?;
        if command_node.stopped().is_some() || woken.ready == [true] {
            return Ok(Ended::Done);
        }
    }
}

/// Prints changes.
struct Writer {
    json: bool,
    out: Output,
    /// The items that exist. A removal names only the key of the item.
    known: BTreeMap<Key, NamedItem>,
}

impl Writer {
    fn write(
        &mut self,
        command_node: &CommandNode,
        domain: &Mirror,
        changes: &[Change],
    ) -> Result<(), CliError> {
        let view = View::new(domain);
        let itself = command_node.node.name();
        for change in changes {
            match change {
                Change::Set { item } => {
                    let named = NamedItem::new(&view, item);
                    if !named.belongs_to(itself) {
                        self.line(domain.revision(), "set", &named)?;
                    }
                    self.known.insert(item.key(), named);
                }
                Change::Removed { key } => {
                    let gone = self.known.remove(key);
                    if let Some(named) = gone.filter(|it| !it.belongs_to(itself)) {
                        self.line(domain.revision(), "removed", &named)?;
                    }
                }
            }
        }
        self.out.flush()
    }

    fn line(
        &mut self,
        revision: u64,
        change: &'static str,
        named: &NamedItem,
    ) -> Result<(), CliError> {
        if self.json {
            return self.out.json(&Line {
                revision,
                change,
                named,
            });
        }
        let sign = if change == "set" { '+' } else { '-' };
        self.out.line(format_args!("{sign} {named}"))
    }
}
