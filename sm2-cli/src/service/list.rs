use clap::Args;
use serde::Serialize;
use sm2_proto::{Kind, Name};

use crate::{
    args::Domain,
    columns::Columns,
    connect::Session,
    ended::Ended,
    error::CliError,
    interfaces::Type,
    output::Output,
    view::{SERVICE, View},
};

/// `sm2 service list`.
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
  sm2 service list
  sm2 service list --json | jq -r '.services[] | select(.servers == 0).name'";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Services {
    /// The domain's revision.
    revision: u64,
    services: Vec<Service>,
}

/// A service.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct Service {
    name: String,
    /// `None` if no interface has stated the type.
    request: Option<Type>,
    /// `None` if no interface has stated the type.
    reply: Option<Type>,
    servers: usize,
    clients: usize,
    links: usize,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let session = Session::open(&arguments.domain, "service-list")?;
    let domain = session.snapshot()?;
    let view = View::new(&domain);
    let names = view.names(SERVICE).into_iter();
    let services = Services {
        revision: domain.revision(),
        services: names.map(|name| service(&view, name)).collect(),
    };
    let mut out = Output::new();
    match arguments.json {
        true => out.json(&services)?,
        false => out.line(table(&services.services))?,
    }
    Ok(Ended::Done)
}

fn service(view: &View<'_>, name: &Name) -> Service {
    let types = view.service_types(name);
    let servers = || view.on(name, &[Kind::Server]);
    Service {
        name: name.to_string(),
        request: types.map(|[request, _]| request.into()),
        reply: types.map(|[_, reply]| reply.into()),
        servers: servers().count(),
        clients: view.on(name, &[Kind::Client]).count(),
        links: servers().map(|it| view.links_of(it.entity).len()).sum(),
    }
}

fn table(services: &[Service]) -> Columns<6> {
    let mut table = Columns::new(["SERVICE", "REQUEST", "REPLY", "SERVERS", "CLIENTS", "LINKS"]);
    let name = |of: &Option<Type>| of.as_ref().map_or("-", |it| &*it.name).to_owned();
    for service in services {
        table.push([
            service.name.clone(),
            name(&service.request),
            name(&service.reply),
            service.servers.to_string(),
            service.clients.to_string(),
            service.links.to_string(),
        ]);
    }
    table
}
