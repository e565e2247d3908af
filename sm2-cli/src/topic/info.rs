use clap::Args;
use serde::Serialize;
use sm2_proto::Name;

use crate::{
    args::{Domain, name},
    broken_promises::{LostLiveliness, MissedDeadlines},
    connect::Session,
    ended::Ended,
    error::CliError,
    interfaces::{self, Interface, Stated, table},
    output::Output,
    sampling::Sample,
    unheard::Unheard,
    view::{TOPIC, View},
};

/// `sm2 topic info`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The topic
    #[arg(value_name = "NAME", value_parser = name)]
    topic: Name,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
Shows the type of the topic, and the schema by which `sm2 topic echo` reads its messages. Lists all
its publishers and subscribers, including those that the Manager refused, and the publishers that
published while no subscriber was linked, with the number of these messages. It also lists those that
missed their deadlines or lost liveliness. `sm2 why` explains why two of them are not linked.

Exit status: 0 shown, 1 the topic has no publisher and no subscriber, 2 wrong usage.

Examples:
  sm2 topic info scan
  sm2 topic info scan --json | jq -r .schema";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Info {
    /// The domain's revision.
    revision: u64,
    name: String,
    #[serde(flatten)]
    stated: Stated,
    interfaces: Vec<Interface>,
    /// The publishers that published messages while no subscriber was linked.
    unheard: Vec<Unheard>,
    /// The publishers and subscribers that missed their deadlines.
    missed_deadlines: Vec<MissedDeadlines>,
    /// The publishers that stopped being alive, and the subscribers that noticed it.
    lost_liveliness: Vec<LostLiveliness>,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let session = Session::open(&arguments.domain, "topic-info")?;
    let domain = session.snapshot()?;
    let view = View::new(&domain);
    let topic = &arguments.topic;
    let interfaces = interfaces::on(&view, TOPIC, "topic", topic)?;
    let on_topic = (domain.interfaces())
        .filter(|it| TOPIC.contains(&it.contract.kind()) && it.contract.name() == topic);
    let all: Vec<_> = on_topic.map(|it| it.entity).collect();
    let nodes = all.iter().map(|it| it.node).collect();
    let sample = Sample::if_known(&session.node, &domain, &nodes);
    let info = Info {
        revision: domain.revision(),
        name: topic.to_string(),
        stated: Stated::of(&session, view.topic_type(topic))?,
        unheard: Unheard::find(&view, &sample, &all),
        missed_deadlines: MissedDeadlines::find(&view, &sample, &all),
        lost_liveliness: LostLiveliness::find(&view, &sample, &all),
        interfaces,
    };
    let mut out = Output::new();
    match arguments.json {
        true => out.json(&info)?,
        false => print(&info, &mut out)?,
    }
    Ok(Ended::Done)
}

fn print(info: &Info, out: &mut Output) -> Result<(), CliError> {
    out.line(format_args!("topic   {}", info.name))?;
    match &info.stated.data {
        Some(data) => out.line(format_args!("type    {data}"))?,
        None => out.line("type    no interface has stated one")?,
    }
    out.line(format_args!("schema  {}", info.stated.schema()))?;
    out.line("")?;
    out.line(table(&info.interfaces))?;
    for publisher in &info.unheard {
        out.line(format_args!("{publisher}"))?;
    }
    for interface in &info.missed_deadlines {
        out.line(format_args!("{interface}"))?;
    }
    for interface in &info.lost_liveliness {
        out.line(format_args!("{interface}"))?;
    }
    Ok(())
}
