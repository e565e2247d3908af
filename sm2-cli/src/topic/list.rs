//! `sm2 topic list`.

use serde::Serialize;
use sm2_proto::{Kind, Name, domain::InterfaceView};

use crate::{
    columns::{Column, Row},
    ended::Ended,
    error::CliError,
    interfaces::{Type, type_cell},
    report::{List, Options},
    view::{TOPIC, View, count, topic_type},
};

pub(super) const HELP: &str = "\
Examples:
  sm2 topic list
  sm2 topic list --json | jq -r '.topics[].name'";

#[derive(Serialize)]
struct Topic {
    name: String,
    /// `None` if no interface has stated the type.
    #[serde(rename = "type")]
    data: Option<Type>,
    publishers: usize,
    subscribers: usize,
    links: usize,
}

impl Row for Topic {
    const COLUMNS: &'static [Column<Self>] = &[
        ("TOPIC", |it| it.name.clone()),
        ("TYPE", |it| type_cell(it.data.as_ref())),
        ("PUBLISHERS", |it| it.publishers.to_string()),
        ("SUBSCRIBERS", |it| it.subscribers.to_string()),
        ("LINKS", |it| it.links.to_string()),
    ];
}

pub(super) fn run(options: &Options) -> Result<Ended, CliError> {
    options.print("topic-list", |_, view| {
        let topics = view.by_name(TOPIC).into_iter();
        let rows = topics.map(|(name, its)| topic(view, name, &its)).collect();
        let name = "topics";
        Ok(List { name, rows })
    })
}

fn topic(view: &View<'_>, name: &Name, interfaces: &[InterfaceView<'_>]) -> Topic {
    let data = interfaces.iter().find_map(|it| topic_type(it.contract));
    Topic {
        name: name.to_string(),
        data: data.map(Type::from),
        publishers: count(interfaces, Kind::Publisher),
        subscribers: count(interfaces, Kind::Subscriber),
        links: view.links_from(interfaces),
    }
}
