//! Shows the type and the interfaces of one topic.

use clap::Args;
use serde::Serialize;
use sm2_proto::Name;

use crate::{
    args::name,
    columns::Table,
    ended::Ended,
    error::CliError,
    interface_troubles::InterfaceTroubles,
    interfaces::{self, InterfaceReport, StatedType},
    report::{Options, Report, facts},
    sampling::Sample,
    view::TOPIC,
};

/// `sm2 topic info`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The topic
    #[arg(value_name = "NAME", value_parser = name)]
    topic: Name,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
Shows the type of the topic, and the schema that `sm2 topic echo` needs to read its messages. Lists all
its publishers and subscribers, including those that the Manager refused, and the publishers that
published while no subscriber was linked, with the number of these messages. It also lists those that
missed their deadlines or lost liveliness. `sm2 why` explains why two of them are not linked.

Exit status: 0 shown, 1 the topic has no publisher and no subscriber, 2 wrong usage.

Examples:
  sm2 topic info scan
  sm2 topic info scan --json | jq -r .type.schema";

#[derive(Serialize)]
struct Info {
    name: String,
    #[serde(rename = "type")]
    data: StatedType,
    interfaces: Vec<InterfaceReport>,
    #[serde(flatten)]
    troubles: InterfaceTroubles,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let topic = &arguments.topic;
    arguments.options.print("topic-info", |command_node, view| {
        let interfaces = interfaces::on(view, TOPIC, "topic", topic)?;
        let entities: Vec<_> = interfaces.iter().map(InterfaceReport::entity).collect();
        let nodes = entities.iter().map(|it| it.node).collect();
        let sample = Sample::if_known(&command_node.node, view.domain, &nodes);
        Ok(Info {
            name: topic.to_string(),
            data: StatedType::of(command_node, view.topic_type(topic))?,
            interfaces,
            troubles: InterfaceTroubles::find(view, &sample, &entities),
        })
    })
}

impl Report for Info {
    fn text(&self) -> String {
        let [data, schema] = self.data.texts();
        let facts = facts(&[("topic", &self.name), ("type", &data), ("schema", &schema)]);
        let table = [String::new(), Table(&self.interfaces).to_string()];
        let lines: Vec<_> = facts
            .into_iter()
            .chain(table)
            .chain(self.troubles.lines())
            .collect();
        lines.join("\n")
    }
}
