use std::{
    fs,
    io::{self, Read, Write},
    os::fd::AsFd,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use serde::Serialize;
use sm2_io::clock;
use sm2_node::{CallError, Client, Reply};
use sm2_proto::{Contract, Instant, Name, TypeId};

use crate::{
    args::{Domain, name},
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    messages::{self, Content, Schemas, Show, bytes_of},
    names,
    output::Output,
    time,
    view::{SERVICE, View},
    wait::For,
};

/// `sm2 service call`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The service
    #[arg(value_name = "NAME", value_parser = name)]
    service: Name,
    /// The request as JSON, encoded by the schema of its type [default: an empty request]
    #[arg(
        value_name = "JSON",
        conflicts_with = "from",
        allow_hyphen_values = true
    )]
    value: Option<String>,
    /// The request's bytes: a file, or `-` for all of standard input
    #[arg(long, value_name = "PATH|-")]
    from: Option<PathBuf>,
    /// The timeout for finding a server and for its reply
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    timeout: Duration,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    show: Show,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
Calls one server: if there are several, the one that was linked first. The reply is printed as
`sm2 topic echo` prints messages.

Exit status: 0 the reply was printed, 1 there is no reply, 2 wrong usage, 130 Ctrl-C before the reply.

Examples:
  sm2 service call sum '[1, 2, 3]'
  sm2 service call plan '{\"goal\": {\"x\": 1, \"y\": 2}}' --timeout 30s --json
  sm2 service call blob --from request.bin --hex";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Answer<'a> {
    service: &'a str,
    /// The server's node.
    server: &'a str,
    /// The time from sending the request to receiving the reply.
    took_ms: f64,
    len_bytes: usize,
    #[serde(flatten)]
    content: Content<'a>,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let value = arguments.value.as_deref().map(serde_json::from_str);
    let value: Option<serde_json::Value> = value.transpose().map_err(CliError::Json)?;
    let given = arguments.from.as_deref().map(read).transpose()?;
    let command_node = CommandNode::open(&arguments.domain, "call")?;
    let client = client(&command_node, &arguments.service)?;
    let until = clock::now().after(arguments.timeout);
    let [request_type, reply_type] = server(&arguments.service, &command_node, &client, until)?;
    let mut schemas = Schemas::default();
    let request = match (given, value) {
        (Some(bytes), _) => bytes,
        (None, Some(value)) => {
            let schema = schemas.of(&command_node, &request_type)?;
            bytes_of(&value, &request_type, schema)?
        }
        (None, None) => Vec::new(),
    };
    let start = clock::now();
    let reply = call(&command_node, &client, &request, until)?;
    let took = clock::now().since(start);
    // A copy: the server may still be able to change the reply while it is checked and decoded.
    let bytes = reply.to_vec();
    let schema = match arguments.show.decodes(&reply_type) {
        true => schemas.shown(&command_node, &reply_type),
        false => None,
    };
    let mut out = Output::new();
    if arguments.json {
        out.json(&Answer {
            service: arguments.service.as_str(),
            server: reply.server().as_str(),
            took_ms: (took.as_secs_f64() * 1e6).round() / 1e3,
            len_bytes: bytes.len(),
            content: Content::new(&bytes, schema, arguments.show),
        })?;
    } else {
        let lines = messages::lines(&bytes, schema, arguments.show);
        out.write(|out| out.write_all(&lines))?;
    }
    Ok(Ended::Done)
}

/// Calls a service of any types with these bytes. Returns a copy of the reply.
pub(crate) fn ask(
    command_node: &CommandNode,
    service: &Name,
    request: &[u8],
    timeout: Duration,
) -> Result<Vec<u8>, CliError> {
    let client = client(command_node, service)?;
    let until = clock::now().after(timeout);
    server(service, command_node, &client, until)?;
    Ok(call(command_node, &client, request, until)?.to_vec())
}

/// A client of any types.
fn client(command_node: &CommandNode, service: &Name) -> Result<Client<[u8], [u8]>, CliError> {
    let builder = command_node.node.client_builder(service.as_str());
    Ok(builder.any_types().declare()?)
}

/// Waits for a server, and returns its types.
fn server(
    service: &Name,
    command_node: &CommandNode,
    client: &Client<[u8], [u8]>,
    until: Instant,
) -> Result<[TypeId; 2], CliError> {
    loop {
        let links = client.links();
        let open = links.iter().filter(|link| link.open && link.end.is_none());
        let types = open
            .map(|link| &link.peer.contract)
            .find_map(|it| match it {
                Contract::Server { request, reply, .. } => Some([request.clone(), reply.clone()]),
                _ => None,
            });
        command_node.fail_if_stopped()?;
        if let Some(types) = types {
            return Ok(types);
        }
        if clock::now() >= until {
            return Err(no_server(service, command_node));
        }
        command_node.step(&[(client.as_fd(), For::Reading)], Some(until))?;
    }
}

fn no_server(service: &Name, command_node: &CommandNode) -> CliError {
    // An error of the Manager is reported elsewhere.
    let hint = command_node.snapshot().map_or_else(
        |_| String::new(),
        |domain| {
            let known = View::new(&domain).names(SERVICE);
            names::hint(
                service.as_str(),
                known.into_iter().filter(|it| *it != service),
            )
        },
    );
    let service = service.to_string();
    CliError::NoServer { service, hint }
}

/// Sends the request and waits for the reply. A signal cancels the call.
fn call(
    command_node: &CommandNode,
    client: &Client<[u8], [u8]>,
    request: &[u8],
    until: Instant,
) -> Result<Reply<[u8]>, CliError> {
    let left = until.since(clock::now());
    let mut call = client.send_timeout(request, left)?;
    loop {
        match call.try_wait() {
            Ok(None) => {}
            Ok(Some(reply)) => return Ok(reply),
            Err(error @ CallError::Cancelled { .. }) => {
                command_node.fail_if_stopped()?;
                return Err(error.into());
            }
            Err(error) => return Err(error.into()),
        }
        command_node.fail_if_stopped()?;
        command_node.step(&[(client.as_fd(), For::Reading)], Some(until))?;
    }
}

fn read(path: &Path) -> Result<Vec<u8>, CliError> {
    if path.as_os_str() != "-" {
        return fs::read(path).map_err(|source| CliError::file("read", path, source));
    }
    let mut bytes = Vec::new();
    let read = io::stdin().lock().read_to_end(&mut bytes);
    read.map_err(|source| CliError::file("read", Path::new("standard input"), source))?;
    Ok(bytes)
}
