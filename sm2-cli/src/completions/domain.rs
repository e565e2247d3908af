//! The names in the running domain, for completions.

use std::{collections::BTreeMap, env, os::fd::AsFd, path::PathBuf, process, time::Duration};

use clap_complete::CompletionCandidate;
use sm2_io::clock;
use sm2_node::{
    Node,
    params::{self, Table, limits::TABLE_MAX},
};
use sm2_proto::{Name, domain::Domain as Mirror};

use crate::{
    connect::drive,
    param,
    view::{SERVICE, TOPIC, View},
    wait::For,
};

/// The longest time for each answer of the Manager, and for the parameters of a node. A person waits for the shell.
const TIMEOUT: Duration = Duration::from_millis(500);

/// Names, each with a text for shells that show one.
type Names = BTreeMap<String, String>;

/// The kind of value of an argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Values {
    Topics,
    Services,
    Nodes,
    /// Nodes that have parameters.
    NodesWithParameters,
    /// The parameters of the node that the command line names.
    Parameters,
    /// Names of parameters and new values, in turns.
    Assignments,
    /// Nodes, topics and services, and interfaces as `NODE:NAME`.
    Interfaces,
    /// Conditions of `sm2 wait`.
    Conditions,
}

/// The command line that is being completed.
pub(super) struct Line {
    words: Vec<String>,
    /// The position of the word that is being completed.
    at: usize,
}

impl Line {
    /// The line that the arguments and the environment of this process have: `sm2 -- sm2 topic echo sc`.
    pub(super) fn of_process() -> Self {
        let words = env::args_os().skip_while(|it| it != "--").skip(1);
        let words: Vec<_> = words.map(|it| it.to_string_lossy().into_owned()).collect();
        let at = env::var("_CLAP_COMPLETE_INDEX").ok();
        let at = at.and_then(|it| it.parse().ok());
        Self {
            // A shell without the variable completes the last word.
            at: at.unwrap_or(words.len().saturating_sub(1)),
            words,
        }
    }

    /// The value of an option, as `--option VALUE` or `--option=VALUE`.
    fn option(&self, option: &str) -> Option<&str> {
        let mut words = self.words.iter();
        while let Some(word) = words.next() {
            match word.strip_prefix(option) {
                Some("") => return words.next().map(String::as_str),
                Some(rest) if rest.starts_with('=') => return Some(&rest[1..]),
                _ => {}
            }
        }
        None
    }

    /// The path of the Manager's socket.
    fn socket(&self) -> Option<PathBuf> {
        match self.option("--socket") {
            Some(path) => Some(path.into()),
            None => sm2_io::socket_path(self.option("--domain")).ok(),
        }
    }

    /// The words before the one that is being completed.
    fn before(&self) -> &[String] {
        &self.words[..self.at.min(self.words.len())]
    }

    /// The kind of a condition before the word. Bash makes three words of `topic:scan`, and two of `topic:`.
    fn kind(&self) -> Option<&str> {
        let mut before = self.before().iter().rev();
        before.find(|it| *it != ":").map(String::as_str)
    }
}

/// The values that begin with `current`. None if no Manager answers.
pub(super) fn candidates(values: Values, line: &Line, current: &str) -> Vec<CompletionCandidate> {
    let found = find(values, line, current).unwrap_or_default();
    let candidates = found.into_iter().map(|(name, help)| {
        let help = Some(help).filter(|it| !it.is_empty());
        CompletionCandidate::new(name).help(help.map(Into::into))
    });
    candidates.collect()
}

fn find(values: Values, line: &Line, current: &str) -> Option<Names> {
    let name = format!("sm2-complete-{}", process::id());
    let builder = Node::builder(&name).socket(line.socket()?);
    let node = builder.manager_timeout(TIMEOUT).connect().ok()?;
    let domain = node.snapshot().ok()?;
    let view = View::new(&domain);
    // All commands take a name with one leading slash.
    let slash = if current.starts_with('/') { "/" } else { "" };
    let all = match values {
        Values::Topics => topics(&view),
        Values::Services => services(&view),
        Values::Nodes => nodes(&domain, node.name()),
        Values::NodesWithParameters => plain(param::nodes(&domain)),
        Values::Parameters | Values::Assignments => parameters(&node, line, &domain)?,
        Values::Interfaces => interfaces(&view, node.name(), current),
        Values::Conditions => conditions(&view, node.name(), line, current),
    };
    let all = all
        .into_iter()
        .map(|(name, help)| (format!("{slash}{name}"), help));
    Some(all.filter(|(name, _)| name.starts_with(current)).collect())
}

fn plain(names: impl IntoIterator<Item = Name>) -> Names {
    let names = names.into_iter().map(|it| (it.to_string(), String::new()));
    names.collect()
}

/// The topics of programs: not those of the parameters of nodes.
fn topics(view: &View<'_>) -> Names {
    let names = view.names(TOPIC).into_iter();
    let names = names.filter(|it| params::node_of(it.as_str()).is_none());
    let typed = names.map(|it| {
        let data = view.topic_type(it).map(|it| it.name.to_string());
        (it.to_string(), data.unwrap_or_default())
    });
    typed.collect()
}

fn services(view: &View<'_>) -> Names {
    let names = view.names(SERVICE).into_iter();
    let names = names.filter(|it| params::node_of(it.as_str()).is_none());
    plain(names.cloned())
}

/// The nodes, without the one of this command.
fn nodes(domain: &Mirror, itself: &Name) -> Names {
    plain(
        domain
            .nodes()
            .map(|it| it.name)
            .filter(|it| *it != itself)
            .cloned(),
    )
}

/// Nodes, topics and services; after `NODE:`, the topics and services of that node.
fn interfaces(view: &View<'_>, itself: &Name, current: &str) -> Names {
    let Some((node, _)) = current.split_once(':') else {
        let mut all = nodes(view.domain, itself);
        all.extend(topics(view));
        all.extend(services(view));
        return all;
    };
    let of_node = view.domain.interfaces();
    let of_node = of_node.filter(|it| view.name_of(it.entity.node) == node);
    let titles = of_node.map(|it| (view.title(it.entity), it.contract.kind().to_string()));
    titles.collect()
}

/// `topic:`, `service:` and `node:`, each with its names.
fn conditions(view: &View<'_>, itself: &Name, line: &Line, current: &str) -> Names {
    let all = [
        ("topic", topics(view)),
        ("service", services(view)),
        ("node", nodes(view.domain, itself)),
    ];
    if !current.contains(':')
        && let Some((_, names)) = all.iter().find(|(kind, _)| line.kind() == Some(kind))
    {
        return names.clone();
    }
    let all = all.into_iter().flat_map(|(kind, names)| {
        let with_kind = move |(name, help)| (format!("{kind}:{name}"), help);
        names.into_iter().map(with_kind)
    });
    all.collect()
}

/// The parameters of the node that a word before names.
fn parameters(node: &Node, line: &Line, domain: &Mirror) -> Option<Names> {
    let known = param::nodes(domain);
    let mut words = line.before().iter().filter_map(|it| Name::typed(it).ok());
    let of = words.find(|it| known.contains(it))?;
    let builder = node.subscriber_builder::<Table>(&params::name(of.as_str()));
    let tables = builder.max_len(TABLE_MAX as u64).declare().ok()?;
    let until = clock::now().after(TIMEOUT);
    loop {
        if let Some(table) = tables.try_recv().ok()? {
            table.check().ok()?;
            let rows = table.parameters.iter();
            let rows = rows.map(|it| (it.name.clone(), it.value.to_string()));
            return Some(rows.collect());
        }
        if clock::now() >= until {
            return None;
        }
        drive(node, &[(tables.as_fd(), For::Reading)], Some(until)).ok()?;
    }
}
