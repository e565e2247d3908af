//! The messages of a bag that a command uses.

use std::{collections::BTreeSet, time::Duration};

use clap::Args;
use sm2_bag::{Bag, Filter};
use sm2_proto::Name;

use crate::{
    error::CliError,
    names::hint,
    time,
    topic_patterns::{Patterns, TopicArgument, names, topics},
};

/// The options that choose messages.
#[derive(Args, Debug)]
pub(crate) struct Choice {
    /// Use this topic only, or topics like camera/* (may be given again)
    #[arg(long = "topic", value_name = "TOPIC|GLOB", value_parser = topics)]
    topics: Vec<TopicArgument>,
    #[command(flatten)]
    patterns: Patterns,
    /// Begin at this time after the start of the bag, such as 10s
    #[arg(long, value_name = "TIME", value_parser = time::span_or_zero)]
    start: Option<Duration>,
    /// End at this time after the start of the bag
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    end: Option<Duration>,
}

impl Choice {
    /// Checks that the bags have something for each chosen topic and pattern, and the topics `others`.
    ///
    /// # Errors
    ///
    /// [`CliError::NotInBag`].
    pub(crate) fn check<'a>(
        &self,
        bags: &[Bag],
        others: impl Iterator<Item = &'a str>,
    ) -> Result<(), CliError> {
        let sources = bags.iter().flat_map(Bag::sources);
        let topics: BTreeSet<_> = sources.map(|it| it.0.topic.clone()).collect();
        let mut wanted = self.filter(None);
        wanted.topics.extend(others.map(str::to_owned));
        let unmatched = wanted.unmatched(topics.iter().map(String::as_str));
        let Some(pattern) = unmatched.into_iter().next() else {
            return Ok(());
        };
        let known: Vec<_> = topics.iter().flat_map(|it| Name::typed(it)).collect();
        let hint = hint(&pattern, &known);
        Err(CliError::NotInBag { pattern, hint })
    }

    /// The chosen messages of bags that start at this time, in nanoseconds of the wall clock; `None` without messages.
    pub(crate) fn filter(&self, start_ns: Option<u64>) -> Filter {
        let begin = start_ns.unwrap_or_default();
        let at = |time: Duration| {
            begin.saturating_add(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX))
        };
        Filter {
            topics: names(&self.topics).map(Name::to_string).collect(),
            patterns: self.patterns.with(&self.topics),
            from_ns: self.start.map(at),
            to_ns: self.end.map(at),
        }
    }
}
