//! `sm2-bridge-zenoh`: a bridge between a domain of SM2 and a network of Zenoh.

use std::process::ExitCode;

use sm2_bridge_core::config::RuleTables;
use sm2_bridge_core::program::Program;
use sm2_bridge_zenoh::{Bridge, Config};

fn main() -> ExitCode {
    let program = Program {
        load: Config::load,
        rules,
        start: Bridge::start,
        run: Bridge::run,
        summary: Bridge::summary,
    };
    program.main("sm2-bridge-zenoh")
}

fn rules(config: &Config) -> &RuleTables {
    &config.rules
}
