//! `sm2-test-actor ROLE [--OPTION VALUE]...`: the processes of the end-to-end tests.
//!
//! An actor ends when its standard input does, so that none outlives the tests.

mod connect;
mod crowd;
mod flow;
mod gateway;
mod node;
mod probe;
mod storm;

use std::process::ExitCode;

use sm2_tests::{manager, options::Options};

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let role = arguments.next().unwrap_or_default();
    let options = Options::parse(arguments);
    options.limit_files();
    match role.as_str() {
        "connect" => connect::run(&options),
        "crowd" => crowd::run(&options),
        "flow" => flow::run(&options),
        "gateway" => gateway::run(&options),
        "manager" => manager::run(&options),
        "probe" => probe::run(&options),
        "storm" => storm::run(&options),
        "node" => node::run(&options),
        other => panic!("no role {other:?}"),
    }
}
