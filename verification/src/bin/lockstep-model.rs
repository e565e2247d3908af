//! Searches the scopes of a lockstep: see `model::command`. The expected counts are in `lockstep-model-counts.txt`.

use std::process::ExitCode;

use sm2_verification::model::{command, lockstep::LockstepScope};

fn main() -> ExitCode {
    command::run::<LockstepScope>("lockstep-model", "Searches the scopes of a lockstep")
}
