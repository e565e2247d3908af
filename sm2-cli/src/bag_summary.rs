//! The summary of a bag as text, for `sm2 record` and `sm2 bag`.

use std::{fmt::Write as _, path::Path, time::Duration};

use sm2_bag::{GapReason, Report, TopicReport};
use sm2_proto::{link::Fate, text::Counted};

use crate::{ended::Ended, error::CliError, output::Output, size::Size, time::Span};

/// How many gaps of a topic the text has.
const GAPS_SHOWN: usize = 10;

/// Prints the summary of a bag.
///
/// # Errors
///
/// [`CliError::Output`].
pub(crate) fn print(path: &Path, report: &Report, json: bool) -> Result<(), CliError> {
    Output::new().answer(json, report, |out| show(out, path, report))
}

/// Prints the lines for people.
///
/// # Errors
///
/// [`CliError::Output`].
pub(crate) fn show(out: &mut Output, path: &Path, report: &Report) -> Result<(), CliError> {
    out.line(title(path, report))?;
    for topic in &report.topics {
        for line in topic_lines(topic, report.start_ns) {
            out.line(line)?;
        }
    }
    show_missing(out, report)?;
    for part in &report.damaged {
        out.line(format_args!("  left out as damaged: {part}"))?;
    }
    Ok(())
}

/// A line of the counts of a topic, and indented lines of what is special about it.
fn topic_lines(topic: &TopicReport, start_ns: Option<u64>) -> Vec<String> {
    let size = topic.bytes.map(|it| format!(", {}", Size(it)));
    let mut lines = vec![format!(
        "  {} ({}): {}{}, lost {}",
        topic.name,
        topic.r#type.name,
        Counted::new(topic.messages, "message"),
        size.unwrap_or_default(),
        topic.lost
    )];
    for (messages, text) in [
        (topic.repeated, "of before that it begins with"),
        (topic.not_repeated, "of before that it LACKS: no room"),
    ] {
        if messages > 0 {
            let latched = Counted::new(messages, "latched message");
            lines.push(format!("    {latched} {text}"));
        }
    }
    for gap in topic.gaps.iter().take(GAPS_SHOWN) {
        let at = gap.from_ns.saturating_sub(start_ns.unwrap_or(gap.from_ns));
        lines.push(format!(
            "    {} of {} missing at {} for {}: {}",
            gap.messages,
            gap.publisher,
            Span(Duration::from_nanos(at)),
            Span(Duration::from_nanos(gap.to_ns.saturating_sub(gap.from_ns))),
            reason(gap.reason),
        ));
    }
    let more = topic.gaps.len().saturating_sub(GAPS_SHOWN) as u64;
    if more > 0 {
        let more = Counted::new(more, "gap");
        lines.push(format!("    {more} more (--json has all of them)"));
    }
    lines
}

const fn reason(reason: GapReason) -> &'static str {
    match reason {
        GapReason::Displaced => "newer messages displaced them before they were taken",
        GapReason::Budget => "the disk was too slow for --budget",
        GapReason::DiskFull => "the disk was full",
        GapReason::Damaged => "they were in a damaged part",
        GapReason::TooLong => "they were longer than --max-len",
        GapReason::Unsent(Fate::PoolLimit) => "the pool_limit of the publisher was reached",
        GapReason::Unsent(Fate::NoRoom) => "the publisher did not wait longer",
        GapReason::Unsent(Fate::Expired) => "they were older than their lifespan",
        GapReason::Unsent(fate) => fate.meaning(),
    }
}

/// The first line: the times of a bag, and whether it is complete.
fn title(path: &Path, report: &Report) -> String {
    let mut text = path.display().to_string();
    if let (Some(start), Some(end)) = (report.start_ns, report.end_ns) {
        let length = Span(Duration::from_nanos(end.saturating_sub(start)));
        // Writing to a string cannot fail.
        let _ = write!(text, ": {length} from {}", time_of_day(start));
    }
    match &report.writer {
        // Writing to a string cannot fail.
        Some(by) => {
            let since = time_of_day(by.since_ns);
            let (node, process) = (&by.node, by.process);
            let _ = write!(
                text,
                " (BEING WRITTEN by node {node}, process {process}, since {since})"
            );
        }
        None if !report.complete => {
            text += " (INCOMPLETE: the recording did not end in order; `sm2 bag recover` writes a complete bag)";
        }
        None => {}
    }
    text
}

/// A time of the wall clock.
pub(crate) fn time_of_day(ns: u64) -> String {
    let time = i64::try_from(ns).ok();
    let time = time.and_then(|it| jiff::Timestamp::from_nanosecond(it.into()).ok());
    time.map_or_else(|| format!("{ns} ns"), |it| format!("{it:.3}"))
}

/// Prints the topics that were not recorded for a time.
fn show_missing(out: &mut Output, report: &Report) -> Result<(), CliError> {
    for missing in &report.missing {
        let start = report.start_ns.unwrap_or(missing.from_ns);
        let at = |time_ns: u64| Span(Duration::from_nanos(time_ns.saturating_sub(start)));
        let (topic, reason) = (&missing.topic, &missing.reason);
        match missing.to_ns {
            Some(to) => out.line(format_args!(
                "  MISSING {topic} from {} to {}: {reason}",
                at(missing.from_ns),
                at(to)
            ))?,
            None => out.line(format_args!(
                "  MISSING {topic} from {} to the end: {reason}",
                at(missing.from_ns)
            ))?,
        }
    }
    let unnamed = report
        .not_recorded
        .saturating_sub(report.missing.len() as u64);
    if unnamed > 0 {
        let more = Counted::new(unnamed, "more topic");
        out.line(format_args!("  MISSING {more} (not named)"))?;
    }
    Ok(())
}

/// The result of a command that has written a bag with this summary: no, if the bag lacks what was damaged.
pub(crate) const fn ended(report: &Report) -> Ended {
    Ended::with_answer(report.damaged.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use sm2_bag::{Gap, TopicType};

    fn topic(gaps: usize) -> TopicReport {
        let gap = |number: u64| Gap {
            publisher: "camera".to_owned(),
            from_ns: number * 1_000_000_000,
            to_ns: (number + 1) * 1_000_000_000,
            messages: number,
            reason: GapReason::Budget,
        };
        TopicReport {
            name: "image".to_owned(),
            r#type: TopicType {
                name: "bytes".to_owned(),
                hash: None,
            },
            messages: 3,
            gaps: (1..=gaps as u64).map(gap).collect(),
            ..TopicReport::default()
        }
    }

    #[test]
    fn a_topic_without_gaps_has_one_line() {
        let lines = topic_lines(&topic(0), Some(0));
        assert_eq!(lines, ["  image (bytes): 3 messages, lost 0"]);
    }

    #[test]
    fn the_first_gaps_are_named_and_the_others_counted() {
        for (gaps, more) in [
            (GAPS_SHOWN, None),
            (
                GAPS_SHOWN + 1,
                Some("    1 gap more (--json has all of them)"),
            ),
        ] {
            let lines = topic_lines(&topic(gaps), Some(0));
            let named = lines.iter().filter(|it| it.contains("of camera missing"));
            assert_eq!(named.count(), GAPS_SHOWN);
            let last = lines.last().filter(|it| !it.contains("missing"));
            assert_eq!(last.map(String::as_str), more);
        }
    }

    #[test]
    fn latched_messages_of_before_are_told_where_there_are_any() {
        let topic = TopicReport {
            repeated: 2,
            not_repeated: 1,
            ..topic(0)
        };
        let lines = topic_lines(&topic, None);
        assert_eq!(
            lines[1..],
            [
                "    2 latched messages of before that it begins with",
                "    1 latched message of before that it LACKS: no room"
            ]
        );
    }
}
