use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    io::Write,
    path::PathBuf,
};

use clap::Args;
use serde::Serialize;
use sm2_proto::{
    Contract, Name,
    gateway::{Action, Direction, SubjectKind},
    text::Counted,
};

use super::{error::ProgramError, output::write_answer};
use crate::{
    Config, is_remote, keys,
    report::{ShadowReport, kind_name},
    shadow::{Seen, changes},
    tally::Key,
};

/// `sm2 gateway check`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The configuration
    #[arg(value_name = "FILE")]
    config: PathBuf,
    /// List what the rules and peers of this configuration would change
    #[arg(long, value_name = "FILE")]
    shadow: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// The object that `--json` prints.
#[derive(Serialize)]
struct Checked {
    config: String,
    name: Name,
    id: String,
    peers: u64,
    rules: u64,
    /// Why the domain was not asked what it has. The file may be checked on a machine without the domain.
    unreachable: Option<String>,
    /// The topics and services that the domain has and peers may have.
    allowed: Vec<Allowed>,
    /// The changes that the other configuration would make; `None` without `--shadow`.
    shadow: Option<Vec<ShadowReport>>,
}

/// A topic or service that a peer may have.
#[derive(Serialize)]
struct Allowed {
    peer: Name,
    /// `topic` or `service`.
    kind: &'static str,
    name: Name,
    /// The line of the rule.
    line: usize,
}

pub(super) fn run(arguments: &Arguments, out: &mut impl Write) -> Result<(), ProgramError> {
    let config = Config::load(&arguments.config)?;
    let shadow = arguments.shadow.as_deref();
    let shadow = shadow.map(Config::load).transpose()?;
    let id = keys::load(&config.key)?.id();
    let mut checked = Checked {
        config: config.path.display().to_string(),
        name: config.name.clone(),
        id: id.to_string(),
        peers: config.peers.len() as u64,
        rules: config.rule_lines.len() as u64,
        unreachable: None,
        allowed: Vec::new(),
        shadow: None,
    };
    if config.peers.iter().any(|it| it.id == id) {
        return Err(ProgramError::OwnId {
            config: config.path,
        });
    }
    match subjects(&config) {
        Ok(subjects) => {
            checked.allowed = allowed(&config, &subjects);
            checked.shadow = shadow.map(|it| compare(&config, &it, subjects));
        }
        Err(ProgramError::Connect(error)) => checked.unreachable = Some(error.to_string()),
        Err(error) => return Err(error),
    }
    write_answer(out, arguments.json, &checked)
}

/// The topics and services of the domain.
fn subjects(config: &Config) -> Result<BTreeSet<Key>, ProgramError> {
    let name = format!("sm2-gateway-check-{}", std::process::id());
    let node = config.domain.connect(&name)?;
    let domain = node.snapshot()?;
    let own = domain.interfaces().filter(|it| {
        let node = domain.node(it.entity.node);
        it.refused.is_none() && node.is_some_and(|node| !is_remote(node.name))
    });
    let subjects = own.filter_map(|it| match it.contract {
        Contract::Publisher { topic, .. } => Some((SubjectKind::Topic, topic.clone())),
        Contract::Server { service, .. } => Some((SubjectKind::Service, service.clone())),
        Contract::Subscriber { .. } | Contract::Client { .. } => None,
    });
    Ok(subjects.collect())
}

fn allowed(config: &Config, subjects: &BTreeSet<Key>) -> Vec<Allowed> {
    let mut all = Vec::new();
    for peer in &config.peers {
        for (kind, name) in subjects {
            let (action, rule) = config.explain(*kind, name, Direction::Out, &peer.id);
            if let (Action::Allow, Some(line)) = (action, rule) {
                all.push(Allowed {
                    peer: peer.name.clone(),
                    kind: kind_name(*kind),
                    name: name.clone(),
                    line,
                });
            }
        }
    }
    all
}

/// Compares both files for what the domain has. Only a running gateway knows what peers offer.
fn compare(config: &Config, shadow: &Config, local: BTreeSet<Key>) -> Vec<ShadowReport> {
    let seen = Seen {
        local,
        offers: BTreeMap::new(),
    };
    let [now, then] = [config, shadow].map(Config::rule_set);
    let names = config.peers.iter().chain(&shadow.peers);
    let names: BTreeMap<_, _> = names.map(|it| (it.id, it.name.clone())).collect();
    let changes = changes(&now, &then, &seen);
    let changes = changes.iter();
    let reports = changes.map(|it| ShadowReport::new(it, &names, &shadow.rule_lines));
    reports.collect()
}

impl fmt::Display for Checked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (peers, rules) = (
            Counted::new(self.peers, "peer"),
            Counted::new(self.rules, "rule"),
        );
        let Self {
            config, name, id, ..
        } = self;
        write!(f, "{config}: {name} is {id}, with {peers} and {rules}")?;
        if let Some(reason) = &self.unreachable {
            write!(f, "\ncannot list what it would carry: {reason}")?;
        }
        for it in &self.allowed {
            let (peer, kind, name, line) = (&it.peer, it.kind, &it.name, it.line);
            write!(f, "\n{peer} may have {kind} {name} (line {line})")?;
        }
        match self.shadow.as_deref() {
            None => Ok(()),
            Some([]) => f.write_str("\nshadow: no change for what the domain has now"),
            Some(changes) => changes
                .iter()
                .try_for_each(|it| write!(f, "\nshadow: {it}")),
        }
    }
}
