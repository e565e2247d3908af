use std::collections::BTreeMap;

use clap::Args;
use serde::Serialize;
use sm2_proto::{Contract, Name};

use crate::{
    args::Domain, columns::Columns, connect::Session, ended::Ended, error::CliError,
    interfaces::Type, output::Output, view::View,
};

/// `sm2 topic list`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
Examples:
  sm2 topic list
  sm2 topic list --json | jq -r '.topics[].name'";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Topics {
    /// The domain's revision.
    revision: u64,
    topics: Vec<TopicRow>,
}

/// A topic.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct TopicRow {
    name: String,
    /// `None` if no interface has stated the type.
    #[serde(rename = "type")]
    data: Option<Type>,
    publishers: usize,
    subscribers: usize,
    links: usize,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let session = Session::open(&arguments.domain, "topic-list")?;
    let domain = session.snapshot()?;
    let view = View::new(&domain);
    let topics = Topics {
        revision: domain.revision(),
        topics: topics(&view),
    };
    let mut out = Output::new();
    match arguments.json {
        true => out.json(&topics)?,
        false => out.line(table(&topics.topics))?,
    }
    Ok(Ended::Done)
}

/// The topics in the order of their names.
fn topics(view: &View<'_>) -> Vec<TopicRow> {
    let mut topics: BTreeMap<&Name, TopicRow> = BTreeMap::new();
    for it in view.granted() {
        let (data, publishes) = match it.contract {
            Contract::Publisher { data, .. } => (Some(data), true),
            Contract::Subscriber { data, .. } => (data.as_ref(), false),
            Contract::Server { .. } | Contract::Client { .. } => continue,
        };
        let name = it.contract.name();
        let topic = topics.entry(name).or_insert_with(|| TopicRow {
            name: name.to_string(),
            data: None,
            publishers: 0,
            subscribers: 0,
            links: 0,
        });
        topic.data = topic.data.take().or_else(|| data.map(Type::from));
        if publishes {
            topic.publishers += 1;
            // Each link has exactly one publisher, so each link counts once.
            topic.links += view.links_of(it.entity).len();
        } else {
            topic.subscribers += 1;
        }
    }
    topics.into_values().collect()
}

fn table(topics: &[TopicRow]) -> Columns<5> {
    let mut table = Columns::new(["TOPIC", "TYPE", "PUBLISHERS", "SUBSCRIBERS", "LINKS"]);
    for topic in topics {
        let data = topic.data.as_ref();
        table.push([
            topic.name.clone(),
            data.map_or_else(|| "-".into(), |data| data.name.clone()),
            topic.publishers.to_string(),
            topic.subscribers.to_string(),
            topic.links.to_string(),
        ]);
    }
    table
}
