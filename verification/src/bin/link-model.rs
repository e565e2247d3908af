//! Searches the scopes of one link: see `model::command`. The expected counts are in `link-model-counts.txt`.

use std::process::ExitCode;

use sm2_verification::model::{command, link::LinkScope};

fn main() -> ExitCode {
    command::run::<LinkScope>("link-model", "Searches the scopes of one link")
}
