//! `sm2-bridge-nats`: a bridge between a domain of SM2 and a stream of NATS JetStream.

use std::process::ExitCode;

use sm2_bridge_core::program::Program;
use sm2_bridge_nats::{Bridge, Config};

fn main() -> ExitCode {
    let program = Program {
        load: Config::load,
        parts: |it: &Config| (&it.domain, &it.rules),
        start: Bridge::start,
        set_shadow: Bridge::set_shadow,
        run: Bridge::run,
        account: Bridge::account,
    };
    program.main("sm2-bridge-nats")
}
