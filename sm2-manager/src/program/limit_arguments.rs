//! The options of the command line that set limits: one for each limit of the Manager.

use std::fmt::Write as _;

use clap::{Arg, ArgMatches, Args, Command, FromArgMatches, value_parser};
use sm2_proto::{
    control::{Limit, LimitError, Unit},
    manager::Policy,
};

/// The limits that a command line states.
#[derive(Clone, Debug)]
pub struct LimitArguments {
    /// The value of each limit, in the order of [`Limit::ALL`] and in the unit of [`Limit::unit`].
    given: [Option<u64>; Limit::COUNT],
}

impl LimitArguments {
    /// The default policy with these limits. A limit that is not stated has its default, and at most the value
    /// of its [`whole`](Limit::whole).
    ///
    /// # Errors
    ///
    /// The [`LimitError`] of the first wrong limit.
    pub(super) fn policy(&self) -> Result<Policy, LimitError> {
        let mut policy = Policy::default();
        for limit in Limit::ALL {
            policy.set(limit, self.value(limit));
        }
        policy.check()?;
        Ok(policy)
    }

    fn value(&self, limit: Limit) -> u64 {
        self.given[limit as usize].unwrap_or_else(|| {
            let most = limit.whole().map_or(u64::MAX, |whole| self.value(whole));
            Policy::default().value(limit).min(most)
        })
    }
}

impl FromArgMatches for LimitArguments {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        Ok(Self {
            given: Limit::ALL.map(|limit| {
                let stated = matches.get_one::<u64>(limit.name()).copied();
                stated.map(|it| it.saturating_mul(per_option(limit)))
            }),
        })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Args for LimitArguments {
    fn augment_args(command: Command) -> Command {
        command.args(Limit::ALL.map(argument))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

/// The units of a limit in one unit of its option: times are stated in seconds.
const fn per_option(limit: Limit) -> u64 {
    match limit.unit() {
        Unit::Milliseconds => 1_000,
        Unit::Count | Unit::Bytes => 1,
    }
}

fn argument(limit: Limit) -> Arg {
    let value_name = match limit.unit() {
        Unit::Count => "N",
        Unit::Milliseconds => "SECONDS",
        Unit::Bytes => "BYTES",
    };
    let mut help = limit.to_string();
    help[..1].make_ascii_uppercase();
    let default = Policy::default().value(limit) / per_option(limit);
    // `write!` to a string cannot fail.
    let _ = match limit.whole() {
        Some(whole) => write!(
            help,
            " [default: {default}, at most that of {}]",
            whole.option()
        ),
        None => write!(help, " [default: {default}]"),
    };
    Arg::new(limit.name())
        .long(limit.option().trim_start_matches('-'))
        .value_name(value_name)
        .value_parser(value_parser!(u64))
        .help(help)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        limits: LimitArguments,
    }

    fn policy(options: &[&str]) -> Result<Policy, LimitError> {
        let line = Line::try_parse_from([&["sm2-manager"], options].concat());
        line.unwrap().limits.policy()
    }

    #[test]
    fn without_options_the_limits_are_the_defaults() {
        assert_eq!(policy(&[]), Ok(Policy::default()));
    }

    #[test]
    fn each_option_sets_its_limit_and_no_other() {
        for limit in Limit::ALL {
            // Not a default of any limit, and not more than the limit of a whole.
            let stated = match limit.unit() {
                Unit::Milliseconds | Unit::Count => 37,
                Unit::Bytes => 300_037,
            };
            let policy = policy(&[limit.option(), &stated.to_string()]).unwrap();
            assert_eq!(policy.value(limit), stated * per_option(limit), "{limit}");
            for other in Limit::ALL.into_iter().filter(|it| *it != limit) {
                let is_part = |it: Limit| it.whole() == Some(limit);
                let is_lowered = is_part(other) || other.whole().is_some_and(is_part);
                let default = Policy::default().value(other);
                let expected = if is_lowered {
                    stated.min(default)
                } else {
                    default
                };
                assert_eq!(policy.value(other), expected, "{limit}, {other}");
            }
        }
    }

    #[test]
    fn a_part_that_is_stated_may_not_exceed_its_whole() {
        let refused = LimitError::AboveWhole {
            limit: Limit::SessionsPerProcess,
            value: 5,
            whole: Limit::SessionsPerUser,
            most: 4,
        };
        let line = ["--max-sessions", "4", "--max-process-sessions", "5"];
        assert_eq!(policy(&line), Err(refused));
    }

    #[test]
    fn a_number_that_is_too_large_is_refused() {
        for limit in Limit::ALL {
            let result = policy(&[limit.option(), &u64::MAX.to_string()]);
            let refused = LimitError::OutOfRange {
                limit,
                value: u64::MAX,
            };
            assert_eq!(result, Err(refused));
        }
    }
}
