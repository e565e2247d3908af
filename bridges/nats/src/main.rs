//! `sm2-bridge-nats`: a bridge between a domain of SM2 and a stream of NATS JetStream.

use std::process::ExitCode;

use sm2_bridge_nats::Bridge;

fn main() -> ExitCode {
    sm2_bridge_core::program::main::<Bridge>("sm2-bridge-nats")
}
