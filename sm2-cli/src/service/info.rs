use clap::Args;
use serde::Serialize;
use sm2_proto::Name;

use crate::{
    args::{Domain, name},
    connect::Session,
    ended::Ended,
    error::CliError,
    interfaces::{self, Interface, Stated, table},
    output::Output,
    view::{SERVICE, View},
};

/// `sm2 service info`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The service
    #[arg(value_name = "NAME", value_parser = name)]
    service: Name,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
Exit status: 0 shown, 1 the service has no server and no client, 2 wrong usage.

Examples:
  sm2 service info sum
  sm2 service info sum --json | jq -r .request.schema";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Info {
    /// The domain's revision.
    revision: u64,
    name: String,
    request: Stated,
    reply: Stated,
    interfaces: Vec<Interface>,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let session = Session::open(&arguments.domain, "service-info")?;
    let domain = session.snapshot()?;
    let view = View::new(&domain);
    let service = &arguments.service;
    let interfaces = interfaces::on(&view, SERVICE, "service", service)?;
    let [request, reply] = match view.service_types(service) {
        Some(types) => types.map(Some),
        None => [None; 2],
    };
    let info = Info {
        revision: domain.revision(),
        name: service.to_string(),
        request: Stated::of(&session, request)?,
        reply: Stated::of(&session, reply)?,
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
    out.line(format_args!("service         {}", info.name))?;
    for (what, half) in [("request", &info.request), ("reply", &info.reply)] {
        match &half.data {
            Some(data) => out.line(format_args!("{what:<16}{data}"))?,
            None => out.line(format_args!("{what:<16}no interface has stated a type"))?,
        }
        let schema = format!("{what} schema");
        out.line(format_args!("{schema:<16}{}", half.schema()))?;
    }
    out.line("")?;
    out.line(table(&info.interfaces))
}
