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
