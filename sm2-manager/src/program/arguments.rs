//! The options of the command line.

use std::path::PathBuf;

use clap::Args;
use sm2_proto::control::{LimitError, Limits};

use super::limit_arguments::LimitArguments;
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
    /// The limits
    #[command(flatten)]
    pub limits: LimitArguments,
}

impl Arguments {
    /// # Errors
    ///
    /// The [`LimitError`] of the first wrong limit.
    pub(super) fn options(&self) -> Result<Options, LimitError> {
        let limits = Limits {
            seal_all: self.seal_all,
            waive_user_boundary: self.waive_user_boundary,
            ..self.limits.limits()?
        };
        Ok(Options {
            limits,
            socket_mode: self.socket_mode,
            policy_file: self.policy.clone(),
        })
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

#[cfg(test)]
mod tests {
    use clap::Parser;
    use sm2_proto::control::Limit;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        arguments: Arguments,
    }

    fn parsed(options: &[&str]) -> Result<Arguments, clap::Error> {
        let line = Line::try_parse_from([&["sm2-manager"], options].concat());
        line.map(|it| it.arguments)
    }

    #[test]
    fn a_mode_is_made_of_permission_bits() {
        for (text, mode) in [("0", 0), ("600", 0o600), ("0660", 0o660), ("777", 0o777)] {
            let arguments = parsed(&["--socket-mode", text]).unwrap();
            let options = arguments.options().unwrap();
            assert_eq!(options.socket_mode, mode, "{text}");
            assert_eq!(options.bind_options().mode, mode, "{text}");
        }
        for text in ["1000", "1777", "8", "rw", "", "-1"] {
            let option = format!("--socket-mode={text}");
            assert!(parsed(&[&option]).is_err(), "{text}");
        }
    }

    #[test]
    fn each_option_is_an_option_of_the_manager() {
        let options = |line: &[&str]| parsed(line).unwrap().options().unwrap();
        let defaults = options(&[]);
        assert_eq!(defaults.limits, Limits::default());
        assert_eq!((defaults.socket_mode, defaults.policy_file), (0o600, None));
        let sealed = options(&["--seal-all", "--sessions-per-user", "5"]).limits;
        assert!(sealed.seal_all && !sealed.waive_user_boundary);
        assert_eq!(sealed.of(Limit::SessionsPerUser), 5);
        let waived = options(&["--waive-user-boundary"]).limits;
        assert!(waived.waive_user_boundary && !waived.seal_all);
        assert!(parsed(&["--waive-user-boundary", "--seal-all"]).is_err());
        let policy = options(&["--policy", "robot.toml"]).policy_file;
        assert_eq!(policy, Some(PathBuf::from("robot.toml")));
    }

    #[test]
    fn a_path_is_explicit_if_the_line_names_a_socket_or_a_domain() {
        let explicit = |line: &[&str]| parsed(line).unwrap().explicit_path().unwrap();
        assert_eq!(explicit(&[]), None);
        assert_eq!(explicit(&["--socket", "/a/b"]), Some(PathBuf::from("/a/b")));
        let arm = sm2_io::socket_path(Some("arm")).unwrap();
        assert_eq!(explicit(&["--domain", "arm"]), Some(arm));
    }
}
