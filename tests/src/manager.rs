//! `manager`: the Manager as the `sm2 manager` command runs it.

use std::process::ExitCode;

use sm2_manager::{Policy, program};

use crate::{input::abort_at_end, options::Options};

/// Runs a Manager until its standard input ends.
#[must_use]
pub fn run(options: &Options) -> ExitCode {
    abort_at_end();
    let policy = Policy::default();
    let mode: String = options.get_or("--socket-mode", "600".to_owned());
    let arguments = program::Arguments {
        domain: options.get("--domain"),
        socket: options.get("--socket"),
        policy: options.get("--policy"),
        socket_mode: u32::from_str_radix(&mode, 8).expect("octal digits"),
        standby: options.get_or("--standby", false),
        replace: options.get_or("--replace", false),
        seal_all: options.get_or("--seal-all", false),
        waive_user_boundary: options.get_or("--waive-user-boundary", false),
        max_sessions: options.get_or("--max-sessions", policy.sessions_per_user),
        max_process_sessions: options.get_or("--max-process-sessions", policy.sessions_per_process),
        max_process_interfaces: options
            .get_or("--max-process-interfaces", policy.interfaces_per_process),
        max_interfaces: options.get_or("--max-interfaces", policy.interfaces_per_session),
        max_links: options.get_or("--max-links", policy.links_per_session),
        greeting_timeout: options.get_or("--greeting-timeout", 2),
    };
    program::main(&arguments)
}
