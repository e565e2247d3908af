use std::{ffi::CString, path::PathBuf};

use clap::{
    Args,
    builder::{PossibleValuesParser, TypedValueParser},
};
use nix::unistd::{Gid, Group, Uid, User, getgrouplist, getuid};
use serde::Serialize;
use sm2_manager::PolicyFile;
use sm2_proto::{
    Name,
    policy::{self, Action, Effect, Subject},
};

use crate::{
    args,
    ended::Ended,
    error::CliError,
    report::{Report, print},
};

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
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

const HELP: &str = "\
Shows the rule that decides, with its line. A binding that keeps the process from the name of the node
denies everything. An exclusive topic has one publisher at a time.

Exit status: 0 allowed, 1 denied (or the file is not a policy), 2 wrong usage.

Examples:
  sm2 policy explain policy.toml --node talker --action publish --name chatter
  sm2 policy explain policy.toml --node talker --action publish --name chatter --json | jq .rule
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
    let at = |table: &Name| At {
        name: table.clone(),
        line: file.line_of(table),
    };
    let subject = Subject::new(subject_user(arguments), node.clone());
    let binding = file.policy.binding_against(subject.user(), node);
    let decision = file.policy.decide(&subject, action, name);
    let exclusive = match action {
        Action::Publish => file.policy.exclusive(name),
        _ => None,
    };
    let explained = Explained {
        file: file.path.display().to_string(),
        node: node.clone(),
        action: action.word(),
        name: name.clone(),
        allowed: binding.is_none() && decision.effect == Effect::Allow,
        binding: binding.map(|it| at(&it.name)),
        decision: match decision.effect {
            Effect::Allow => "allowed",
            Effect::Deny => "denied",
        },
        rule: decision
            .rule
            .and_then(|it| file.policy.rule_name(it))
            .map(at),
        exclusive: exclusive.map(|it| at(&it.name)),
    };
    print(&explained, arguments.json)?;
    Ok(Ended::with_answer(explained.allowed))
}

/// A table of the policy.
#[derive(Serialize)]
struct At {
    name: Name,
    /// Its line in the file; `None` if the file gives it no name.
    line: Option<usize>,
}

impl At {
    /// `` `drivers` at policy.toml:3 ``
    fn text(&self, file: &str) -> String {
        match self.line {
            Some(line) => format!("`{}` at {file}:{line}", self.name),
            None => format!("`{}`", self.name),
        }
    }
}

/// The object that `--json` prints.
#[derive(Serialize)]
struct Explained {
    file: String,
    node: Name,
    action: &'static str,
    name: Name,
    /// Whether the process may do it under this name of its node.
    allowed: bool,
    /// The binding that denies the name of the node.
    binding: Option<At>,
    /// `allowed` or `denied`, by the rule or the default.
    decision: &'static str,
    /// The rule that decides; `None` if it is the default.
    rule: Option<At>,
    /// The entry that limits the topic to one publisher.
    exclusive: Option<At>,
}

impl Report for Explained {
    fn text(&self) -> String {
        let Self {
            file,
            node,
            action,
            name,
            decision,
            ..
        } = self;
        let mut lines = Vec::new();
        if let Some(binding) = &self.binding {
            let by = binding.text(file);
            lines.push(format!("{node} is denied as a name by the binding {by}"));
        }
        lines.push(match &self.rule {
            Some(rule) => format!(
                "{action} {name}: {decision} by the rule {}",
                rule.text(file)
            ),
            None => {
                format!("{action} {name}: {decision} by the default of {file}, as no rule matches")
            }
        });
        if let Some(entry) = &self.exclusive {
            let by = entry.text(file);
            lines.push(format!(
                "{name} has at most one publisher, by the entry {by}"
            ));
        }
        lines.join("\n")
    }
}
