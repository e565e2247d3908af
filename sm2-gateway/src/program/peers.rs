use std::{io::Write, time::Duration};

use clap::Args;
use sm2_proto::text::Counted;

use super::{error::ProgramError, options::Domain, output::write_line};
use crate::{
    Report,
    peer::Limit,
    report::{self, PeerReport},
    tally::Counts,
};

/// Timeout of the gateways.
const TIMEOUT: Duration = Duration::from_secs(2);

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
    let node = arguments.domain.location().connect(&name)?;
    let services = report::gateways(&node.snapshot()?);
    if services.is_empty() {
        return Err(ProgramError::NoGateway);
    }
    // Shows the reports of those that answer, then fails if another one did not.
    let mut failed = None;
    for (_, report) in report::ask(&node, services, TIMEOUT) {
        match report {
            Ok(report) if arguments.json => write_line(out, serde_json::json!(report))?,
            Ok(report) => table(&report, out)?,
            Err(error) => failed = Some(error),
        }
    }
    failed.map_or(Ok(()), |error| Err(error.into()))
}

fn table(report: &Report, out: &mut impl Write) -> Result<(), ProgramError> {
    write_line(out, format!("{} ({})", report.name, report.id))?;
    let limits = Limit::ALL.map(|it| format!("{} {}", it.name(), report.limits.of(it)));
    write_line(out, format!("  limits: {}", limits.join(", ")))?;
    if report.peers.is_empty() {
        write_line(out, "  no peer is connected")?;
    }
    for peer in &report.peers {
        one(peer, out)?;
    }
    for it in report.shadow.iter().flatten() {
        write_line(out, format!("  shadow: {it}"))?;
    }
    for subject in &report.waiting {
        write_line(out, format!("  no descriptors for {subject}"))?;
    }
    for name in &report.absent {
        write_line(out, format!("  {name}: not connected"))?;
    }
    Ok(())
}

fn one(peer: &PeerReport, out: &mut impl Write) -> Result<(), ProgramError> {
    let at = peer.address.as_deref().unwrap_or("an unknown address");
    let rtt = peer.rtt_ms.unwrap_or(f64::NAN);
    let (name, age) = (&peer.name, age(peer.connected_s));
    write_line(out, format!("  {name} at {at}{age}, RTT {rtt:.1} ms"))?;
    let m = &peer.messages;
    for text in [
        format!(
            "out: {} offered, {} sent, {} superseded, {} expired, {} withdrawn",
            m.offered, m.sent, m.superseded, m.expired, m.withdrawn
        ),
        format!(
            "in:  {} received, {} refused, {} skipped",
            m.received, m.refused, m.skipped
        ),
        format!(
            "{} lost here, {} denied",
            m.lost,
            Counted::new(peer.denied, "name")
        ),
    ] {
        write_line(out, format!("    {text}"))?;
    }
    for (word, subjects) in [("may have", &peer.offered), ("offers", &peer.offers)] {
        for subject in subjects {
            write_line(out, format!("    {word} {subject}"))?;
        }
    }
    for it in &peer.subjects {
        let counts = nonzero_counts(&it.counts);
        write_line(out, format!("    {} {}: {counts}", it.kind, it.name))?;
    }
    for it in &peer.denials {
        let why = match it.line {
            Some(at) => format!("line {at}"),
            None => "no rule matches".to_owned(),
        };
        let (kind, name, direction) = (&it.kind, &it.name, &it.direction);
        write_line(
            out,
            format!("    denied {direction}: {kind} {name} ({why})"),
        )?;
    }
    Ok(())
}

/// `, connected for 2 h 5 min`, or nothing if the connection did not report in time.
fn age(connected_s: Option<f64>) -> String {
    let Some(seconds) = connected_s else {
        return String::new();
    };
    let seconds = seconds as u64;
    let (days, hours, minutes) = (seconds / 86_400, seconds / 3_600 % 24, seconds / 60 % 60);
    let age = match (days, hours, minutes) {
        (0, 0, 0) => format!("{seconds} s"),
        (0, 0, _) => format!("{minutes} min {} s", seconds % 60),
        (0, ..) => format!("{hours} h {minutes} min"),
        _ => format!("{days} d {hours} h"),
    };
    format!(", connected for {age}")
}

/// The counts that are not zero.
fn nonzero_counts(counts: &Counts) -> String {
    let counts = [
        (counts.offered, "offered"),
        (counts.sent, "sent"),
        (counts.superseded, "superseded"),
        (counts.expired, "expired"),
        (counts.withdrawn, "withdrawn"),
        (counts.received, "received"),
        (counts.refused, "refused"),
        (counts.lost, "lost here"),
        (counts.skipped, "skipped"),
    ];
    let counts = counts.iter().filter(|(count, _)| *count > 0);
    let counts: Vec<_> = counts
        .map(|(count, word)| format!("{count} {word}"))
        .collect();
    match counts.is_empty() {
        true => "no messages yet".to_owned(),
        false => counts.join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_age_has_its_two_greatest_units() {
        assert_eq!(age(None), "");
        for (seconds, text) in [
            (0.4, "0 s"),
            (59.9, "59 s"),
            (61.0, "1 min 1 s"),
            (7_500.0, "2 h 5 min"),
            (180_000.0, "2 d 2 h"),
        ] {
            assert_eq!(age(Some(seconds)), format!(", connected for {text}"));
        }
    }

    #[test]
    fn only_what_was_counted_is_shown() {
        let none = Counts::default();
        assert_eq!(nonzero_counts(&none), "no messages yet");
        let few = Counts {
            offered: 2,
            skipped: 1,
            ..none
        };
        assert_eq!(nonzero_counts(&few), "2 offered, 1 skipped");
        assert_eq!(
            nonzero_counts(&Counts::ALL_DIFFERENT),
            "1 offered, 2 sent, 3 superseded, 4 expired, 5 withdrawn, 6 received, 7 refused, 8 lost here, 9 skipped"
        );
    }
}
