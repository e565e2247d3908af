//! `sm2-bridge-nats`: a bridge between a domain of SM2 and a stream of NATS JetStream.

use std::process::ExitCode;

use sm2_bridge_core::config::RuleTables;
use sm2_bridge_core::program::Program;
use sm2_bridge_nats::{Bridge, Config};

fn main() -> ExitCode {
    let program = Program {
        load: Config::load,
        rules,
        start: Bridge::start,
        run: Bridge::run,
        summary: |it: &Bridge| it.counts().to_string(),
    };
    program.main("sm2-bridge-nats")
}

fn rules(config: &Config) -> &RuleTables {
    &config.rules
}
