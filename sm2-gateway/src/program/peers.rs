//! `sm2 gateway peers`.

use std::{collections::BTreeSet, io::Write, time::Duration};

use clap::Args;
use sm2_node::Client;
use sm2_proto::{Contract, Name};

use super::{Domain, ProgramError, line};
use crate::Report;

/// How long a gateway may take to answer.
const PATIENCE: Duration = Duration::from_secs(2);

/// `sm2 gateway peers`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Print one JSON object for each gateway
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

pub(super) fn run(arguments: &Arguments, out: &mut impl Write) -> Result<(), ProgramError> {
    let name = format!("sm2-gateway-peers-{}", std::process::id());
    let node = arguments.domain.place().node(&name)?;
    let domain = node.snapshot()?;
    let services = domain.interfaces().filter_map(|it| match it.contract {
        Contract::Server { service, .. } if is_status(service) => Some(service.clone()),
        _ => None,
    });
    let services: BTreeSet<Name> = services.collect();
    if services.is_empty() {
        return Err(ProgramError::NoGateway);
    }
    for service in services {
        let client: Client<[u8], [u8]> = node.client(service.as_str())?;
        // Whether there is one the call says.
        let _ = client.wait_for_servers(1, Some(PATIENCE));
        let report = client.call(&[], PATIENCE)?;
        let report: Report =
            serde_json::from_slice(&report).map_err(|source| ProgramError::NoReport {
                gateway: service.to_string(),
                source,
            })?;
        match arguments.json {
            true => line(out, serde_json::json!(report))?,
            false => table(&report, out)?,
        }
    }
    Ok(())
}

fn is_status(service: &Name) -> bool {
    let name = service.as_str();
    name.starts_with("gateway/") && name.ends_with("/status")
}

fn table(report: &Report, out: &mut impl Write) -> Result<(), ProgramError> {
    line(out, format!("{} ({})", report.name, report.id))?;
    if report.peers.is_empty() {
        return line(out, "  no peer is connected");
    }
    for peer in &report.peers {
        let m = &peer.messages;
        line(
            out,
            format!(
                "  {} at {}, {:.1} ms there and back",
                peer.name, peer.address, peer.rtt_ms
            ),
        )?;
        line(
            out,
            format!(
                "    out: {} offered, {} sent, {} superseded, {} expired, {} withdrawn",
                m.offered, m.sent, m.superseded, m.expired, m.withdrawn
            ),
        )?;
        line(
            out,
            format!("    in:  {} received, {} refused", m.received, m.refused),
        )?;
        for (word, subjects) in [("may have", &peer.offered), ("offers", &peer.offers)] {
            for subject in subjects {
                line(out, format!("    {word} {subject}"))?;
            }
        }
    }
    Ok(())
}
