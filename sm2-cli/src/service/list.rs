//! `sm2 service list`.

use serde::Serialize;
use sm2_proto::{Kind, Name, domain::InterfaceView};

use crate::{
    columns::{Column, Row},
    ended::Ended,
    error::CliError,
    interfaces::{Type, type_cell},
    report::{List, Options},
    view::{SERVICE, View, count, service_types},
};

pub(super) const HELP: &str = "\
Examples:
  sm2 service list
  sm2 service list --json | jq -r '.services[] | select(.servers == 0).name'";

#[derive(Serialize)]
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

impl Row for Service {
    const COLUMNS: &'static [Column<Self>] = &[
        ("SERVICE", |it| it.name.clone()),
        ("REQUEST", |it| type_cell(it.request.as_ref())),
        ("REPLY", |it| type_cell(it.reply.as_ref())),
        ("SERVERS", |it| it.servers.to_string()),
        ("CLIENTS", |it| it.clients.to_string()),
        ("LINKS", |it| it.links.to_string()),
    ];
}

pub(super) fn run(options: &Options) -> Result<Ended, CliError> {
    options.print("service-list", |_, view| {
        let services = view.by_name(SERVICE).into_iter();
        let rows = services.map(|(name, its)| service(view, name, &its));
        let (name, rows) = ("services", rows.collect());
        Ok(List { name, rows })
    })
}

fn service(view: &View<'_>, name: &Name, interfaces: &[InterfaceView<'_>]) -> Service {
    let types = interfaces.iter().find_map(|it| service_types(it.contract));
    Service {
        name: name.to_string(),
        request: types.map(|[request, _]| request.into()),
        reply: types.map(|[_, reply]| reply.into()),
        servers: count(interfaces, Kind::Server),
        clients: count(interfaces, Kind::Client),
        links: view.links_from(interfaces),
    }
}
