use super::*;

fn options(rate_hz: f64, seconds: f64) -> Options {
    Options {
        subscribers: 1,
        size_bytes: SIZE_MIN_BYTES,
        rate_hz,
        seconds,
        is_sealed: false,
        format: Format::Json,
    }
}

#[test]
fn a_run_has_its_rate_for_its_time_and_a_million_messages_at_most() {
    for (rate_hz, seconds, count) in [
        (30.0, 10.0, 300),
        (2.5, 3.0, 8),
        (0.1, 1.0, 1),
        (1e-9, 1e-9, 1),
        (100.0, 10_000.0, 1_000_000),
    ] {
        assert_eq!(options(rate_hz, seconds).count().unwrap(), count);
    }
    for (rate_hz, seconds, expected) in [(1.0, 1_000_001.0, 1_000_001), (1e300, 1e300, u64::MAX)] {
        match options(rate_hz, seconds).count().unwrap_err() {
            DemoError::TooLong { count, limit } => {
                assert_eq!((count, limit), (expected, 1_000_000));
            }
            other => panic!("{other}"),
        }
    }
}

#[test]
fn the_period_is_that_of_the_rate() {
    assert_eq!(options(4.0, 1.0).period(), Duration::from_millis(250));
    assert_eq!(options(0.5, 1.0).period(), Duration::from_secs(2));
    assert_eq!(options(1e-300, 1.0).period(), Duration::MAX);
}

#[test]
fn messages_that_do_not_fit_the_memory_are_refused() {
    options(1.0, 1.0).check_memory().unwrap();
    let check = |size_bytes| {
        let options = Options {
            size_bytes,
            ..options(1.0, 1.0)
        };
        options.check_memory().unwrap_err()
    };
    // An exbibyte, and a size whose multiple has no number.
    for (size, needed) in [(1 << 60, 1 << 62), (u64::MAX, u64::MAX)] {
        match check(size) {
            DemoError::TooLarge {
                size_bytes,
                needed_bytes,
                available_bytes,
            } => {
                assert_eq!((size_bytes, needed_bytes), (size, needed));
                assert!((1..needed).contains(&available_bytes), "{available_bytes}");
            }
            other => panic!("{other}"),
        }
    }
}
