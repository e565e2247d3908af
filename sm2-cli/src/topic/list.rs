//! `sm2 topic list`.

use serde::Serialize;

use super::ListArguments;
use crate::{
    Ended,
    columns::Columns,
    connect::Session,
    domain::{self, Topic},
    error::CliError,
    output::Output,
};

/// The object that `--json` prints.
#[derive(Serialize)]
struct Topics {
    /// The domain's revision.
    revision: u64,
    topics: Vec<Topic>,
}

pub(super) fn run(arguments: &ListArguments) -> Result<Ended, CliError> {
    let session = Session::open(&arguments.domain, "topic-list")?;
    let graph = session.graph()?;
    let topics = Topics {
        revision: graph.revision,
        topics: domain::topics(&graph.items),
    };
    let mut out = Output::new();
    match arguments.json {
        true => out.json(&topics)?,
        false => out.line(table(&topics.topics))?,
    }
    out.flush()?;
    Ok(Ended::Done)
}

fn table(topics: &[Topic]) -> Columns<5> {
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
