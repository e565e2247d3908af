use std::{
    collections::{BTreeMap, BTreeSet},
    io::Write,
    path::PathBuf,
};

use clap::Args;
use sm2_proto::{
    Contract,
    gateway::{Action, Direction, SubjectKind},
    text::Counted,
};

use super::{error::ProgramError, output::write_line};
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
}

pub(super) fn run(arguments: &Arguments, out: &mut impl Write) -> Result<(), ProgramError> {
    let config = Config::load(&arguments.config)?;
    let shadow = arguments.shadow.as_deref();
    let shadow = shadow.map(Config::load).transpose()?;
    let id = keys::load(&config.key)?.id();
    let (peers, rules) = (config.peers.len(), config.rule_lines.len());
    write_line(
        out,
        format!(
            "{}: {} is {id}, with {} and {}",
            config.path.display(),
            config.name,
            Counted::new(peers as u64, "peer"),
            Counted::new(rules as u64, "rule")
        ),
    )?;
    if config.peers.iter().any(|it| it.id == id) {
        return Err(ProgramError::OwnId {
            config: config.path,
        });
    }
    let name = format!("sm2-gateway-check-{}", std::process::id());
    let node = match config.domain.connect(&name) {
        Ok(node) => node,
        // The file may be checked on a machine without the domain.
        Err(error) => return write_line(out, format!("cannot list what it would carry: {error}")),
    };
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
    let subjects: BTreeSet<_> = subjects.collect();
    for peer in &config.peers {
        for (kind, name) in &subjects {
            let (action, rule) = config.explain(*kind, name, Direction::Out, &peer.id);
            let kind_name = kind_name(*kind);
            if let (Action::Allow, Some(at)) = (action, rule) {
                write_line(
                    out,
                    format!("{} may have {kind_name} {name} (line {at})", peer.name),
                )?;
            }
        }
    }
    match shadow {
        Some(shadow) => compare(&config, &shadow, subjects, out),
        None => Ok(()),
    }
}

/// Compares both files for what the domain has. Only a running gateway knows what peers offer.
fn compare(
    config: &Config,
    shadow: &Config,
    local: BTreeSet<Key>,
    out: &mut impl Write,
) -> Result<(), ProgramError> {
    let seen = Seen {
        local,
        offers: BTreeMap::new(),
    };
    let [now, then] = [config, shadow].map(Config::rule_set);
    let names = config.peers.iter().chain(&shadow.peers);
    let names: BTreeMap<_, _> = names.map(|it| (it.id, it.name.clone())).collect();
    let changes = changes(&now, &then, &seen);
    if changes.is_empty() {
        return write_line(
            out,
            "shadow: no change for what the domain has now".to_owned(),
        );
    }
    for change in changes {
        let change = ShadowReport::new(&change, &names, &shadow.rule_lines);
        write_line(out, format!("shadow: {change}"))?;
    }
    Ok(())
}
