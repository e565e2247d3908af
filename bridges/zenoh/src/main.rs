//! `sm2-bridge-zenoh`: a bridge between a domain of SM2 and a network of Zenoh.

use std::process::ExitCode;

use sm2_bridge_core::program::Program;
use sm2_bridge_zenoh::{Bridge, Config};

fn main() -> ExitCode {
    let program = Program {
        load: Config::load,
        parts: |it: &Config| (&it.domain, &it.rules),
        start: Bridge::start,
        set_shadow: Bridge::set_shadow,
        run: Bridge::run,
        account: Bridge::account,
    };
    program.main("sm2-bridge-zenoh")
}
