//! `sm2-bridge-zenoh`: a bridge between a domain of SM2 and a network of Zenoh.

use std::process::ExitCode;

use sm2_bridge_zenoh::Bridge;

fn main() -> ExitCode {
    sm2_bridge_core::program::main::<Bridge>("sm2-bridge-zenoh")
}
