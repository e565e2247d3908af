use std::{fmt, io::Write, time::Duration};

use clap::Args;
use serde::Serialize;
use sm2_proto::Name;

use super::{
    error::ProgramError,
    options::{Domain, Kind},
    output::write_answer,
};
use crate::{
    availability::{self, Availability, AvailabilityRequest},
    report,
};

/// Timeout of the gateways, including the answer of the peer.
const TIMEOUT: Duration = Duration::from_secs(3);

/// `sm2 gateway ask`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The name of a topic or a service
    #[arg(value_parser = Name::typed)]
    name: Name,
    /// The peer, by its name or its id
    #[arg(long, value_name = "PEER")]
    peer: String,
    /// The kind of the name
    #[arg(long, value_enum, default_value_t = Kind::Topic)]
    kind: Kind,
    /// Print one JSON object for each answer
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

/// Prints the answers. True if the peer offers it to a gateway of the domain.
pub(super) fn run(arguments: &Arguments, out: &mut impl Write) -> Result<bool, ProgramError> {
    let name = format!("sm2-gateway-ask-{}", std::process::id());
    let node = arguments.domain.location().connect(&name)?;
    let services = report::gateways(&node.snapshot()?);
    if services.is_empty() {
        return Err(ProgramError::NoGateway);
    }
    let request = AvailabilityRequest {
        peer: arguments.peer.clone(),
        kind: arguments.kind.into(),
        name: arguments.name.clone(),
    };
    let mut is_offered = false;
    let (mut answers, mut failed) = (Vec::new(), None);
    for (_, answer) in availability::ask(&node, services, &request, TIMEOUT) {
        match answer {
            Ok(answer) => answers.push(answer),
            Err(error) => failed = Some(error),
        }
    }
    // Of several gateways, only those that know the peer count.
    if answers.iter().any(|it| *it != Availability::NoSuchPeer) {
        answers.retain(|it| *it != Availability::NoSuchPeer);
    }
    for answer in answers {
        is_offered |= answer == Availability::Offered;
        let answer = Answer {
            name: arguments.name.clone(),
            peer: arguments.peer.clone(),
            answer,
        };
        write_answer(out, arguments.json, &answer)?;
    }
    match failed {
        Some(error) => Err(error.into()),
        None => Ok(is_offered),
    }
}

/// The object that `--json` prints.
#[derive(Serialize)]
struct Answer {
    name: Name,
    peer: String,
    answer: Availability,
}

impl fmt::Display for Answer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {}: {}", self.name, self.peer, self.answer)
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        arguments: Arguments,
    }

    #[test]
    fn a_name_may_begin_with_a_slash() {
        let line = |name| Line::try_parse_from(["ask", name, "--peer", "far"]);
        for name in ["camera/front", "/camera/front"] {
            let arguments = line(name).unwrap().arguments;
            assert_eq!(arguments.name.as_str(), "camera/front");
        }
        assert!(line("//camera").is_err());
    }
}
