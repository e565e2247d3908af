use std::os::fd::AsFd;

use super::*;

/// A message that arrived at this time.
fn seen_at(at: Instant) -> Seen {
    Seen {
        at,
        age_ns: 1,
        number: 1,
        damaged: false,
    }
}

/// The run goes on behind its end until the far domain has received a message, but not for ever.
#[test]
fn a_run_is_over_at_its_end_if_a_message_has_come() {
    let begin = Instant(1_000_000_000);
    let join_at = begin.after(Duration::from_secs(100));
    let settled = join_at.after(SETTLING);
    let end = begin.after(Duration::from_secs(300));
    let moment = Duration::from_nanos(1);
    let before = |at: Instant| Instant(at.0 - 1);
    let away = [seen_at(settled)];
    assert!(!is_over(before(end), end, join_at, &away));
    assert!(is_over(end, end, join_at, &away));
    // A message from before the rates have settled does not count.
    let early = [seen_at(before(settled))];
    for away in [&early[..], &[]] {
        assert!(!is_over(end, end, join_at, away));
        assert!(!is_over(before(end.after(TIMEOUT)), end, join_at, away));
        assert!(is_over(end.after(TIMEOUT), end, join_at, away));
        assert!(is_over(end.after(TIMEOUT + moment), end, join_at, away));
    }
}

/// The descriptor that ends the run is readable from the start.
#[test]
fn a_run_that_is_stopped_reports_what_it_has() {
    for format in [Format::Json, Format::Lines] {
        let options = Options {
            subscribers: 1,
            size_bytes: 1_000,
            rate_hz: 100.0,
            seconds: 0.5,
            is_sealed: false,
            format,
        };
        let (stop, other) = io::pipe().unwrap();
        drop(other);
        let mut out = Vec::new();
        let ending = run(&options, &mut out, stop.as_fd()).unwrap();
        let text = String::from_utf8(out).unwrap();
        assert_eq!(ending, Ending::Stopped, "{text}");
        let lines: Vec<_> = text.lines().collect();
        if format == Format::Json {
            let report: serde_json::Value = serde_json::from_str(&text).unwrap();
            assert_eq!(report["interrupted"], true, "{text}");
            assert_eq!(lines.len(), 1, "{text}");
        } else {
            let first = "1 kB at 100 Hz in one domain, for 0.5 s; to another domain over a link";
            assert!(lines[0].starts_with(first), "{text}");
            for start in ["  s   local Hz", "  1 ", "local:  ", "remote: "] {
                let those = lines.iter().filter(|it| it.starts_with(start));
                assert_eq!(those.count(), 1, "{start}: {text}");
            }
        }
    }
}
