//! The messages of a bag that a command uses.

use std::time::Duration;

use clap::Args;
use sm2_bag::Filter;
use sm2_proto::Name;

use crate::{args::name, time};

/// The options that choose messages.
#[derive(Args, Debug)]
pub(crate) struct Choice {
    /// Use this topic only (may be given again)
    #[arg(long = "topic", value_name = "TOPIC", value_parser = name)]
    topics: Vec<Name>,
    /// Begin at this time after the start of the bag, such as 10s
    #[arg(long, value_name = "TIME", value_parser = time::span_or_zero)]
    start: Option<Duration>,
    /// End at this time after the start of the bag
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    end: Option<Duration>,
}

impl Choice {
    /// The chosen messages of bags that start at this time, in nanoseconds of the wall clock; `None` without messages.
    pub(crate) fn filter(&self, start_ns: Option<u64>) -> Filter {
        let begin = start_ns.unwrap_or_default();
        let at = |time: Duration| {
            begin.saturating_add(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX))
        };
        Filter {
            topics: self.topics.iter().map(Name::to_string).collect(),
            from_ns: self.start.map(at),
            to_ns: self.end.map(at),
        }
    }
}
