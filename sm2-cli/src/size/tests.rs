use super::*;

fn bytes(text: &str) -> Result<u64, SizeError> {
    text.parse::<Size>().map(|size| size.0)
}

#[test]
fn numbers_and_units_are_read() {
    for (text, expected) in [
        ("1", 1),
        ("4096", 4_096),
        ("4096B", 4_096),
        ("4KB", 4_000),
        ("4kb", 4_000),
        ("4k", 4_000),
        ("4KiB", 4_096),
        ("1MiB", 1_048_576),
        ("10MB", 10_000_000),
        ("10 MB", 10_000_000),
        ("1.5MiB", 1_572_864),
        ("0.5kB", 500),
        ("2GB", 2_000_000_000),
        ("1GiB", 1_073_741_824),
        ("1TiB", MESSAGE_MAX),
    ] {
        assert_eq!(bytes(text), Ok(expected), "{text}");
    }
}

#[test]
fn what_is_no_size_is_told_why() {
    for (text, expected) in [
        ("", SizeError::Form),
        ("MB", SizeError::Form),
        (".5MB", SizeError::Form),
        ("5.MB", SizeError::Form),
        ("1.2.3MB", SizeError::Form),
        ("-1", SizeError::Form),
        ("10 parsecs", SizeError::Form),
        ("1e6", SizeError::Form),
        ("١", SizeError::Form),
        ("0", SizeError::Zero),
        ("0.0MB", SizeError::Zero),
        ("0.5", SizeError::Fraction),
        ("1.0001kB", SizeError::Fraction),
        ("2TiB", SizeError::TooLarge),
        ("99999999999999999999999999", SizeError::TooLarge),
    ] {
        assert_eq!(bytes(text), Err(expected), "{text}");
    }
}

#[test]
fn sizes_are_shown_with_one_decimal() {
    for (bytes, expected) in [
        (0, "0 bytes"),
        (1, "1 byte"),
        (999, "999 bytes"),
        (1_000, "1 kB"),
        (1_550, "1.5 kB"),
        (999_999, "999.9 kB"),
        (10_000_000, "10 MB"),
        (3_000_000_000, "3 GB"),
    ] {
        assert_eq!(Size(bytes).to_string(), expected);
    }
}
