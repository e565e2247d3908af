use std::{ffi::CString, path::PathBuf};

use clap::{
    Args,
    builder::{PossibleValuesParser, TypedValueParser},
};
use nix::unistd::{Gid, Group, Uid, User, getgrouplist, getuid};
use sm2_manager::PolicyFile;
use sm2_proto::{
    Name,
    policy::{self, Action, Effect, Subject},
};

use crate::{args, ended::Ended, error::CliError, output::Output};

/// `sm2 policy explain`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The policy file
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The user of the process, by name or id [default: the present user]
    #[arg(long, value_name = "USER", value_parser = user)]
    user: Option<u32>,
    /// A group of the process, by name or id; may be repeated [default: the groups of the user]
    #[arg(long = "group", value_name = "GROUP", value_parser = group)]
    groups: Vec<u32>,
    /// The name of the node
    #[arg(long, value_name = "NODE", value_parser = args::name)]
    node: Name,
    /// The action
    #[arg(long, value_parser = action())]
    action: Action,
    /// The name of the topic, service or node that the action is about
    #[arg(long, value_name = "NAME", value_parser = args::name)]
    name: Name,
}

const HELP: &str = "\
Shows the rule that decides, with its line. A binding that keeps the process from the name of the node
denies everything. An exclusive topic has one publisher at a time.

Exit status: 0 allowed, 1 denied (or the file is not a policy), 2 wrong usage.

Examples:
  sm2 policy explain policy.toml --node talker --action publish --name chatter
  sm2 policy explain policy.toml --user root --group 0 --node sm2-top --action see --name camera/front";

/// Accepts the words of actions, which the help lists.
fn action() -> impl TypedValueParser<Value = Action> {
    let words = PossibleValuesParser::new(Action::ALL.map(Action::word));
    words.try_map(|word| word.parse::<Action>())
}

fn user(text: &str) -> Result<u32, String> {
    id(text, "user", |name| {
        Ok(User::from_name(name)?.map(|it| it.uid.as_raw()))
    })
}

fn group(text: &str) -> Result<u32, String> {
    id(text, "group", |name| {
        Ok(Group::from_name(name)?.map(|it| it.gid.as_raw()))
    })
}

/// The id that a text states, or that the system has for the name.
fn id(
    text: &str,
    what: &str,
    lookup: impl FnOnce(&str) -> nix::Result<Option<u32>>,
) -> Result<u32, String> {
    if let Ok(id) = text.parse() {
        return Ok(id);
    }
    match lookup(text) {
        Ok(Some(id)) => Ok(id),
        Ok(None) => Err(format!(
            "this machine has no such {what}: give a name or an id"
        )),
        Err(error) => Err(format!("cannot look it up ({error}): give the id")),
    }
}

/// The user and groups of the subject. A user that the system does not know has no groups.
fn subject_user(arguments: &Arguments) -> policy::User {
    let uid = arguments.user.unwrap_or_else(|| getuid().as_raw());
    if !arguments.groups.is_empty() {
        let gids = arguments.groups.clone();
        return policy::User { uid, gids };
    }
    let known = User::from_uid(Uid::from_raw(uid)).ok().flatten();
    let groups = known.and_then(|it| {
        let name = CString::new(it.name).ok()?;
        getgrouplist(&name, it.gid).ok()
    });
    let gids = groups.unwrap_or_default().into_iter().map(Gid::as_raw);
    policy::User {
        uid,
        gids: gids.collect(),
    }
}

/// Runs the command.
///
/// # Errors
///
/// [`CliError::Policy`], [`CliError::Output`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let file = PolicyFile::load(&arguments.file)?;
    let Arguments { node, name, .. } = arguments;
    let action = arguments.action;
    let at = |table: &Name| match file.line_of(table) {
        Some(line) => format!("`{table}` at {}:{line}", file.path.display()),
        None => format!("`{table}`"),
    };
    let subject = Subject::new(subject_user(arguments), node.clone());
    let mut out = Output::new();
    let binding = file.policy.binding_against(subject.user(), node);
    if let Some(binding) = binding {
        let by = at(&binding.name);
        out.line(format_args!(
            "{node} is denied as a name by the binding {by}"
        ))?;
    }
    let decision = file.policy.decide(&subject, action, name);
    let word = match decision.effect {
        Effect::Allow => "allowed",
        Effect::Deny => "denied",
    };
    match decision.rule.and_then(|it| file.policy.rule_name(it)) {
        Some(rule) => out.line(format_args!(
            "{action} {name}: {word} by the rule {}",
            at(rule)
        ))?,
        None => out.line(format_args!(
            "{action} {name}: {word} by the default of {}, as no rule matches",
            file.path.display()
        ))?,
    }
    if action == Action::Publish
        && let Some(entry) = file.policy.exclusive(name)
    {
        let by = at(&entry.name);
        out.line(format_args!(
            "{name} has at most one publisher, by the entry {by}"
        ))?;
    }
    Ok(match (binding, decision.effect) {
        (None, Effect::Allow) => Ended::Done,
        _ => Ended::No,
    })
}
