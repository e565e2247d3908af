//! Topics on the command line: names and patterns.

use clap::Args;
use sm2_bag::{Pattern, TopicPatterns};
use sm2_proto::Name;

use crate::args::name;

/// A topic, or a glob for topics.
#[derive(Clone, Debug)]
pub(crate) enum TopicArgument {
    Name(Name),
    Glob(Pattern),
}

/// Parses a topic or a glob.
pub(crate) fn topics(text: &str) -> Result<TopicArgument, String> {
    match Pattern::is_glob(text) {
        true => glob(text).map(TopicArgument::Glob),
        false => name(text).map(TopicArgument::Name),
    }
}

fn glob(text: &str) -> Result<Pattern, String> {
    Pattern::glob(text).map_err(|it| it.to_string())
}

fn regex(text: &str) -> Result<Pattern, String> {
    Pattern::regex(text).map_err(|it| it.to_string())
}

/// The names among the arguments.
pub(crate) fn names(arguments: &[TopicArgument]) -> impl Iterator<Item = &Name> {
    arguments.iter().filter_map(|it| match it {
        TopicArgument::Name(name) => Some(name),
        TopicArgument::Glob(_) => None,
    })
}

/// The options that choose topics by patterns.
#[derive(Args, Debug)]
pub(crate) struct Patterns {
    /// Also use topics whose whole names match this regular expression (may be given again)
    #[arg(long, value_name = "REGEX", value_parser = regex)]
    regex: Vec<Pattern>,
    /// Leave out topics like this, also if they were chosen (may be given again)
    #[arg(long, value_name = "TOPIC|GLOB", value_parser = glob)]
    exclude: Vec<Pattern>,
    /// Leave out topics whose whole names match this regular expression (may be given again)
    #[arg(long, value_name = "REGEX", value_parser = regex)]
    exclude_regex: Vec<Pattern>,
}

impl Patterns {
    /// The patterns of these options, and of the arguments.
    pub(crate) fn with(&self, arguments: &[TopicArgument]) -> TopicPatterns {
        let globs = arguments.iter().filter_map(|it| match it {
            TopicArgument::Glob(glob) => Some(glob),
            TopicArgument::Name(_) => None,
        });
        TopicPatterns {
            include: globs.chain(&self.regex).cloned().collect(),
            exclude: self
                .exclude
                .iter()
                .chain(&self.exclude_regex)
                .cloned()
                .collect(),
        }
    }
}
