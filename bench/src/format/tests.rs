use super::number;

#[test]
fn numbers_have_three_digits_that_count() {
    for (value, text) in [
        (0.0, "0"),
        (1_234_567.0, "1,230,000"),
        (999.6, "1,000"),
        (123.4, "123"),
        (12.34, "12.3"),
        (0.012_345, "0.0123"),
        (-1_234.0, "-1,230"),
        (-123.0, "-123"),
    ] {
        assert_eq!(number(value), text);
    }
}
