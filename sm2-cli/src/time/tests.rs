use super::*;

#[test]
fn spans_are_read_with_their_units() {
    for (text, nanos) in [
        ("5s", 5_000_000_000),
        ("200ms", 200_000_000),
        ("1.5 s", 1_500_000_000),
        ("250us", 250_000),
        ("7ns", 7),
        ("2m", 120_000_000_000),
        ("1h", 3_600_000_000_000),
        (".5s", 500_000_000),
    ] {
        assert_eq!(span(text), Ok(Duration::from_nanos(nanos)), "{text}");
    }
    assert_eq!(span_or_zero("0"), Ok(Duration::ZERO));
    assert_eq!(span_or_zero("0s"), Ok(Duration::ZERO));
}

#[test]
fn what_is_no_span_is_told_what_is() {
    for text in [
        "",
        "5",
        "s",
        "5 parsecs",
        "-1s",
        "1e3s",
        "1.2.3s",
        "5S",
        "5sec",
        "nan",
    ] {
        let error = span(text).unwrap_err();
        assert!(error.contains("200ms"), "{text}: {error}");
    }
    assert!(span("0s").unwrap_err().contains("above 0"));
    assert!(span("9000h").unwrap_err().contains("at most"));
}

#[test]
fn spans_are_shown_in_a_unit_that_suits_them() {
    for (nanos, text) in [
        (0, "0 ns"),
        (999, "999 ns"),
        (1_500, "1.5 us"),
        (250_000_000, "250 ms"),
        (90_000_000_000, "90 s"),
    ] {
        assert_eq!(Span(Duration::from_nanos(nanos)).to_string(), text);
    }
}
