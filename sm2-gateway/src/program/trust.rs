use std::{fs, path::PathBuf};

use clap::Args;
use sm2_proto::{Name, gateway::GatewayId};

use super::error::ProgramError;
use crate::{Address, Config};

/// `sm2 gateway trust`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The configuration
    #[arg(value_name = "FILE")]
    config: PathBuf,
    /// The name for the peer
    #[arg(value_parser = Name::new)]
    name: Name,
    /// Its id, as `sm2 gateway id` prints it there
    id: GatewayId,
    /// An address of the peer, such as 192.0.2.1:7633 or robot.local:7633
    #[arg(value_name = "ADDRESS")]
    addresses: Vec<Address>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let path = &arguments.config;
    let read = fs::read_to_string(path);
    let text = read.map_err(ProgramError::system(format!("read {}", path.display())))?;
    // A rule may name the peer before the file has it, or another peer that is added later.
    Config::parse_without_peers(path, &text)?;
    let peer = entry(arguments);
    // Inserts before the first rule, since rules refer to peers above them.
    let at = text.find("[[rule]]").unwrap_or(text.len());
    let (before, after) = text.split_at(at);
    let gap = if before.ends_with('\n') { "" } else { "\n" };
    let new = format!("{before}{gap}{peer}{after}");
    Config::parse_without_peers(path, &new)?;
    replace(path, &new)
}

fn entry(arguments: &Arguments) -> String {
    let addresses = arguments.addresses.iter().map(|it| format!("\"{it}\""));
    let addresses = addresses.collect::<Vec<_>>().join(", ");
    format!(
        "[[peer]]\nname = \"{}\"\nid = \"{}\"\naddresses = [{addresses}]\n\n",
        arguments.name, arguments.id
    )
}

/// Replaces the file atomically.
fn replace(path: &PathBuf, text: &str) -> Result<(), ProgramError> {
    let new = path.with_extension("toml.new");
    let failed = || ProgramError::system(format!("write {}", path.display()));
    fs::write(&new, text).map_err(failed())?;
    fs::rename(&new, path).map_err(|error| {
        // Best effort: removes the incomplete copy.
        let _ = fs::remove_file(&new);
        failed()(error)
    })
}
