use std::{fmt, io::Write, path::PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;
use sm2_proto::{
    Name,
    gateway::{Action, Direction},
};

use super::{error::ProgramError, options::Kind, output::write_answer};
use crate::Config;

/// `sm2 gateway explain`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The name of a topic or a service
    #[arg(value_parser = Name::typed)]
    name: Name,
    /// The configuration
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The peer, by its name or its id
    #[arg(long, value_name = "PEER")]
    peer: String,
    /// From this domain to the peer, or from the peer to this domain
    #[arg(long, value_enum)]
    direction: DirectionOption,
    /// The kind of the name
    #[arg(long, value_enum, default_value_t = Kind::Topic)]
    kind: Kind,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DirectionOption {
    In,
    Out,
}

/// Prints the decision. True if the name is allowed.
pub(super) fn run(arguments: &Arguments, out: &mut impl Write) -> Result<bool, ProgramError> {
    let config = Config::load(&arguments.config)?;
    let peer = config.peer(&arguments.peer).ok_or_else(|| {
        let known = config.peers.iter().map(|it| it.name.as_str());
        let known: Vec<_> = known.collect();
        ProgramError::NoPeer {
            config: arguments.config.clone(),
            peer: arguments.peer.clone(),
            known: match known.is_empty() {
                true => "none".to_owned(),
                false => known.join(", "),
            },
        }
    })?;
    let direction = match arguments.direction {
        DirectionOption::In => Direction::In,
        DirectionOption::Out => Direction::Out,
    };
    let (action, rule) =
        config.explain(arguments.kind.into(), &arguments.name, direction, &peer.id);
    let allowed = action == Action::Allow;
    let explained = Explained {
        name: arguments.name.clone(),
        allowed,
        config: config.path.display().to_string(),
        line: rule,
    };
    write_answer(out, arguments.json, &explained)?;
    Ok(allowed)
}

/// The object that `--json` prints.
#[derive(Serialize)]
struct Explained {
    name: Name,
    allowed: bool,
    config: String,
    /// The line of the rule that decides; `None` if no rule matches.
    line: Option<usize>,
}

impl fmt::Display for Explained {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, config, .. } = self;
        let word = if self.allowed { "allowed" } else { "denied" };
        match self.line {
            Some(at) => write!(f, "{name}: {word} by the rule at {config}:{at}"),
            None => write!(f, "{name}: {word}: no rule of {config} matches"),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        arguments: Arguments,
    }

    #[test]
    fn a_name_may_begin_with_a_slash() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("gateway.toml");
        let id = "01".repeat(32);
        let text = format!(
            "name = \"near\"\nkey = \"key\"\n[[peer]]\nname = \"far\"\nid = \"{id}\"\naddresses = []\n\
             [[rule]]\naction = \"allow\"\nnames = \"camera/**\"\n"
        );
        fs::write(&file, text).unwrap();
        for name in ["camera/front", "/camera/front"] {
            let config = file.to_str().unwrap();
            let words = ["explain", name, "--config", config, "--peer", "far"];
            let line = Line::try_parse_from(words.into_iter().chain(["--direction", "out"]));
            let mut out = Vec::new();
            assert!(run(&line.unwrap().arguments, &mut out).unwrap());
            let said = String::from_utf8(out).unwrap();
            let start = format!("camera/front: allowed by the rule at {config}:7");
            assert!(said.starts_with(&start), "{said}");
        }
        for name in ["//camera", "camera/", ""] {
            let words = ["explain", name, "--config", "gateway.toml", "--peer", "far"];
            let line = Line::try_parse_from(words.into_iter().chain(["--direction", "out"]));
            assert!(line.is_err(), "{name:?}");
        }
    }
}
