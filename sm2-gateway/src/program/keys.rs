//! `sm2 gateway keygen` and `sm2 gateway id`.

use std::{fmt, io::Write, path::PathBuf};

use clap::Args;
use serde::Serialize;

use super::{error::ProgramError, output::write_answer};
use crate::keys;

/// A key file.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The key file
    #[arg(value_name = "KEY")]
    key: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// The object that `--json` prints.
#[derive(Serialize)]
struct Id {
    id: String,
}

impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.id)
    }
}

fn print(
    key: &sm2_io::quic::SecretKey,
    arguments: &Arguments,
    out: &mut impl Write,
) -> Result<(), ProgramError> {
    let id = key.id().to_string();
    write_answer(out, arguments.json, &Id { id })
}

pub(super) fn generate(arguments: &Arguments, out: &mut impl Write) -> Result<(), ProgramError> {
    print(&keys::generate(&arguments.key)?, arguments, out)
}

pub(super) fn id(arguments: &Arguments, out: &mut impl Write) -> Result<(), ProgramError> {
    print(&keys::load(&arguments.key)?, arguments, out)
}
