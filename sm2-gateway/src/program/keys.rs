//! `sm2 gateway keygen` and `sm2 gateway id`.

use std::{io::Write, path::PathBuf};

use clap::Args;

use super::{error::ProgramError, output::write_line};
use crate::keys;

/// A key file.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The key file
    #[arg(value_name = "KEY")]
    key: PathBuf,
}

pub(super) fn generate(arguments: &Arguments, out: &mut impl Write) -> Result<(), ProgramError> {
    write_line(out, keys::generate(&arguments.key)?.id())
}

pub(super) fn id(arguments: &Arguments, out: &mut impl Write) -> Result<(), ProgramError> {
    write_line(out, keys::load(&arguments.key)?.id())
}
