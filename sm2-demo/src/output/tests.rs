use super::*;

#[test]
fn a_size_has_the_largest_unit_and_no_zero_behind_the_point() {
    for (bytes, text) in [
        (16, "16 B"),
        (1_500, "1.5 kB"),
        (64_000, "64 kB"),
        (10_000_000, "10 MB"),
        (10_100_000, "10.1 MB"),
    ] {
        assert_eq!(size_text(bytes), text);
    }
}

#[test]
fn json_is_one_line() {
    let mut out = Vec::new();
    write_json(&mut out, &["a\nb", integrity(true), integrity(false)]).unwrap();
    assert_eq!(
        str::from_utf8(&out).unwrap(),
        "[\"a\\nb\",\"sealed\",\"pooled\"]\n"
    );
}
