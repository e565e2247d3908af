use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use sm2_manager::PolicyFile;
use sm2_proto::{policy::Effect, text::Counted};

use crate::{
    ended::Ended,
    error::CliError,
    report::{Report, print},
};

/// `sm2 policy check`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The policy file
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

const HELP: &str = "\
An error names the line and the key. A warning names a rule that any process could use by choosing the
name of its node, or a rule that an earlier one hides. The file is TOML; this one has all keys:

  default = \"deny\"                       # if no rule matches; or \"allow\"
  [[rule]]                               # the first rule that matches decides
  name = \"drivers\"                       # optional, as in all tables: refusals cite it
  effect = \"allow\"                       # or \"deny\"
  actions = [\"publish\", \"subscribe\", \"serve\", \"call\", \"see\", \"read-counters\"]   # default: all
  names = [\"arm/**\", \"*/status\"]         # topics, services, nodes: * is one segment, ** any number
  users = [\"robot\", 1000]                # names or ids; each condition on the process is optional
  groups = [\"video\"]
  nodes = [\"arm/*\"]                      # patterns of the names of nodes
  peers = [\"base\"]                       # peers of a gateway: their nodes are named remote/PEER
  [[binding]]                            # only these users may name their nodes so
  nodes = [\"arm/*\", \"remote/*\"]
  users = [\"robot\"]
  [[exclusive]]                          # these topics have one publisher at a time
  topics = [\"cmd_vel\"]

Every process may choose the name of its node: a rule with nodes or peers, but without users and
groups, needs a binding of these names. There is no boundary between processes of one user.

Exit status: 0 this is a policy (there may be warnings), 1 it is not, 2 wrong usage.

Examples:
  sm2 policy check policy.toml
  sm2 policy check policy.toml --json | jq '.warnings[]'";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::Policy`], [`CliError::Output`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let file = PolicyFile::load(&arguments.file)?;
    let tables = file.policy.tables();
    let checked = Checked {
        file: file.path.display().to_string(),
        rules: tables.rules.len() as u64,
        bindings: tables.bindings.len() as u64,
        exclusive: tables.exclusive.len() as u64,
        default: match tables.default {
            Effect::Allow => "allow",
            Effect::Deny => "deny",
        },
        warnings: file.warnings().iter().map(ToString::to_string).collect(),
    };
    print(&checked, arguments.json)?;
    Ok(Ended::Done)
}

/// The object that `--json` prints. The numbers are those of tables in the file.
#[derive(Serialize)]
struct Checked {
    file: String,
    rules: u64,
    bindings: u64,
    exclusive: u64,
    /// `allow` or `deny`.
    default: &'static str,
    warnings: Vec<String>,
}

impl Report for Checked {
    fn text(&self) -> String {
        let first = format!(
            "{}: {}, {}, {}; default {}",
            self.file,
            Counted::new(self.rules, "rule"),
            Counted::new(self.bindings, "binding"),
            Counted::new(self.exclusive, "exclusive table"),
            self.default,
        );
        let warnings = self.warnings.iter().map(|it| format!("\nwarning: {it}"));
        first + &warnings.collect::<String>()
    }
}
