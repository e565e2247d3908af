//! The options of the command line.

use std::{path::PathBuf, time::Duration};

use clap::Args;
use sm2_proto::manager::Policy;

use crate::{Options, StartError};

/// Options of a Manager's command line.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// The domain to serve [default: $SM2_DOMAIN, else `default`]
    #[arg(long, value_name = "NAME")]
    pub domain: Option<String>,
    /// Listen at this path instead of the domain's
    #[arg(long, value_name = "PATH", conflicts_with = "domain")]
    pub socket: Option<PathBuf>,
    /// Permissions of the socket, octal: a process needs write permission to connect
    #[arg(long, value_name = "MODE", default_value = "600", value_parser = octal)]
    pub socket_mode: u32,
    /// If another Manager serves the domain, wait until it ends, then take over
    #[arg(long)]
    pub standby: bool,
    /// If another Manager serves the domain, make it hand over (SIGUSR2) and take its place
    #[arg(long, conflicts_with = "standby")]
    pub replace: bool,
    /// The access policy: who may publish, subscribe, serve, call, see and read counters. The Manager links
    /// SOCKET.policy to it, so that every later Manager of the domain uses it [default: SOCKET.policy if it
    /// exists, else everything is allowed]
    #[arg(long, value_name = "FILE")]
    pub policy: Option<PathBuf>,
    /// Seal every message of the domain
    #[arg(long)]
    pub seal_all: bool,
    /// Allow unsealed links between different users
    #[arg(long, conflicts_with = "seal_all")]
    pub waive_user_boundary: bool,
    /// Maximum number of sessions per user
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = Policy::default().sessions_per_user)]
    pub max_sessions: usize,
    /// Maximum number of sessions per process
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = Policy::default().sessions_per_process)]
    pub max_process_sessions: usize,
    /// Maximum number of interfaces per process
    #[arg(long, value_name = "N", default_value_t = Policy::default().interfaces_per_process)]
    pub max_process_interfaces: usize,
    /// Maximum number of interfaces per node
    #[arg(long, value_name = "N", default_value_t = Policy::default().interfaces_per_session)]
    pub max_interfaces: usize,
    /// Maximum number of link ends per node
    #[arg(long, value_name = "N", default_value_t = Policy::default().links_per_session)]
    pub max_links: usize,
    /// Seconds within which a connection has to greet, and a returning node also to claim its links
    #[arg(long, value_name = "SECONDS", default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..))]
    pub greeting_timeout: u64,
}

impl Arguments {
    pub(super) fn options(&self) -> Options {
        let policy = Policy {
            greeting: Duration::from_secs(self.greeting_timeout),
            sessions_per_user: self.max_sessions,
            sessions_per_process: self.max_process_sessions,
            interfaces_per_process: self.max_process_interfaces,
            interfaces_per_session: self.max_interfaces,
            links_per_session: self.max_links,
            seal_all: self.seal_all,
            waive_user_boundary: self.waive_user_boundary,
            ..Policy::default()
        };
        Options {
            policy,
            socket_mode: self.socket_mode,
            policy_file: self.policy.clone(),
            ..Options::default()
        }
    }

    pub(super) fn path(&self) -> Result<PathBuf, StartError> {
        match &self.socket {
            Some(path) => Ok(path.clone()),
            None => Ok(sm2_io::socket_path(self.domain.as_deref())?),
        }
    }

    /// Returns the path if the command line states one.
    pub(super) fn explicit_path(&self) -> Result<Option<PathBuf>, StartError> {
        match (&self.socket, &self.domain) {
            (None, None) => Ok(None),
            _ => self.path().map(Some),
        }
    }
}

fn octal(text: &str) -> Result<u32, String> {
    match u32::from_str_radix(text, 8) {
        Ok(mode) if mode <= 0o777 => Ok(mode),
        _ => Err("give permissions as octal digits, such as 660".into()),
    }
}

/// Parses a number of at least 1: no node could join a Manager that allows none.
fn positive(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if count > 0 => Ok(count),
        _ => Err("give a whole number of at least 1".into()),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use sm2_proto::Quota;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        arguments: Arguments,
    }

    #[test]
    fn the_option_that_a_refusal_names_sets_its_quota() {
        for quota in Quota::ALL {
            let Some(option) = quota.option() else {
                continue;
            };
            let line = Line::try_parse_from(["sm2-manager", option, "7"]).unwrap();
            let policy = line.arguments.options().policy;
            let set = match quota {
                Quota::SessionsPerUser => policy.sessions_per_user,
                Quota::InterfacesPerSession => policy.interfaces_per_session,
                Quota::InterfacesPerUser => policy.interfaces_per_user,
                Quota::LinksPerSession => policy.links_per_session,
                Quota::SessionsPerProcess => policy.sessions_per_process,
                Quota::InterfacesPerProcess => policy.interfaces_per_process,
            };
            assert_eq!(set, 7, "{option}");
        }
    }
}
