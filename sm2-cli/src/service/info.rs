//! Shows the types and interfaces of one service.

use clap::Args;
use serde::Serialize;
use sm2_proto::Name;

use crate::{
    args::name,
    columns::Table,
    ended::Ended,
    error::CliError,
    interfaces::{self, InterfaceReport, StatedType},
    report::{Options, Report, facts},
    view::SERVICE,
};

/// `sm2 service info`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The service
    #[arg(value_name = "NAME", value_parser = name)]
    service: Name,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
Exit status: 0 shown, 1 the service has no server and no client, 2 wrong usage.

Examples:
  sm2 service info sum
  sm2 service info sum --json | jq -r .request.schema";

#[derive(Serialize)]
struct Info {
    name: String,
    request: StatedType,
    reply: StatedType,
    interfaces: Vec<InterfaceReport>,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let service = &arguments.service;
    arguments
        .options
        .print("service-info", |command_node, view| {
            let interfaces = interfaces::on(view, SERVICE, "service", service)?;
            let [request, reply] = match view.service_types(service) {
                Some(types) => types.map(Some),
                None => [None; 2],
            };
            Ok(Info {
                name: service.to_string(),
                request: StatedType::of(command_node, request)?,
                reply: StatedType::of(command_node, reply)?,
                interfaces,
            })
        })
}

impl Report for Info {
    fn text(&self) -> String {
        let ([request, request_schema], [reply, reply_schema]) =
            (self.request.texts(), self.reply.texts());
        let facts = facts(&[
            ("service", &self.name),
            ("request", &request),
            ("request schema", &request_schema),
            ("reply", &reply),
            ("reply schema", &reply_schema),
        ]);
        format!("{}\n\n{}", facts.join("\n"), Table(&self.interfaces))
    }
}
