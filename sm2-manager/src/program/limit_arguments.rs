//! The options of the command line that set limits: one for each limit of the Manager.

use std::fmt::Write as _;

use clap::{Arg, ArgMatches, Args, Command, FromArgMatches, value_parser};
use sm2_proto::control::{Limit, LimitError, Limits, Unit};

/// The limits that a command line states.
#[derive(Clone, Debug)]
pub struct LimitArguments {
    /// The value of each limit, in the order of [`Limit::ALL`] and in the unit of [`Limit::unit`].
    given: [Option<u32>; Limit::COUNT],
}

impl LimitArguments {
    /// The heading of these options in the help.
    pub const HEADING: &str = "Limits";

    /// The default limits but for these. A limit that is not stated has its default, and at most the value of its
    /// [`whole`](Limit::whole).
    ///
    /// # Errors
    ///
    /// The [`LimitError`] of the first wrong limit.
    pub(super) fn limits(&self) -> Result<Limits, LimitError> {
        let limits = Limits {
            values: Limit::ALL.map(|limit| self.value(limit)),
            ..Limits::default()
        };
        limits.check()?;
        Ok(limits)
    }

    fn value(&self, limit: Limit) -> u32 {
        self.given[limit as usize].unwrap_or_else(|| {
            let most = limit.whole().map_or(u32::MAX, |whole| self.value(whole));
            Limits::default().of(limit).min(most)
        })
    }
}

impl FromArgMatches for LimitArguments {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        Ok(Self {
            given: Limit::ALL.map(|limit| matches.get_one(limit.name()).copied()),
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

/// The option that sets a limit: its name with dashes.
fn option(limit: Limit) -> String {
    limit.name().replace('_', "-")
}

fn argument(limit: Limit) -> Arg {
    let value_name = match limit.unit() {
        Unit::Count => "N",
        Unit::Milliseconds => "MS",
        Unit::Bytes => "BYTES",
    };
    let mut help = limit.to_string();
    help[..1].make_ascii_uppercase();
    let default = Limits::default().of(limit);
    // `write!` to a string cannot fail.
    let _ = match limit.whole() {
        Some(whole) => write!(
            help,
            " [default: {default}, at most that of --{}]",
            option(whole)
        ),
        None => write!(help, " [default: {default}]"),
    };
    Arg::new(limit.name())
        .long(option(limit))
        .value_name(value_name)
        .value_parser(value_parser!(u32))
        .help_heading(LimitArguments::HEADING)
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

    fn limits(options: &[&str]) -> Result<Limits, LimitError> {
        let line = Line::try_parse_from([&["sm2-manager"], options].concat());
        line.unwrap().limits.limits()
    }

    #[test]
    fn without_options_the_limits_are_the_defaults() {
        assert_eq!(limits(&[]), Ok(Limits::default()));
    }

    #[test]
    fn each_option_sets_its_limit_and_no_other() {
        for limit in Limit::ALL {
            // Not a default of any limit, and not more than the limit of a whole.
            let stated = match limit.unit() {
                Unit::Milliseconds | Unit::Count => 37,
                Unit::Bytes => 300_037,
            };
            let option = format!("--{}", option(limit));
            let limits = limits(&[&option, &stated.to_string()]).unwrap();
            assert_eq!(limits.of(limit), stated, "{limit}");
            for other in Limit::ALL.into_iter().filter(|it| *it != limit) {
                let is_part = |it: Limit| it.whole() == Some(limit);
                let is_lowered = is_part(other) || other.whole().is_some_and(is_part);
                let default = Limits::default().of(other);
                let expected = if is_lowered {
                    stated.min(default)
                } else {
                    default
                };
                assert_eq!(limits.of(other), expected, "{limit}, {other}");
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
        let line = ["--sessions-per-user", "4", "--sessions-per-process", "5"];
        assert_eq!(limits(&line), Err(refused));
    }

    #[test]
    fn a_number_that_is_too_large_is_refused() {
        for limit in Limit::ALL {
            let option = format!("--{}", option(limit));
            let line = ["sm2-manager", &option, "4294967296"];
            assert!(Line::try_parse_from(line).is_err(), "{limit}");
        }
    }
}
