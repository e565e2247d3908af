use super::*;

/// A row of a test: a text and a number.
struct Named(&'static str, &'static str);

impl Row for Named {
    const COLUMNS: &'static [Column<Self>] =
        &[("NODE", |it| it.0.to_owned()), ("HZ", |it| it.1.to_owned())];
}

/// A row with a column that has a text in one of its rows, and one of numbers.
struct Typed(&'static str, &'static str, &'static str);

impl Row for Typed {
    const COLUMNS: &'static [Column<Self>] = &[
        ("NAME", |it| it.0.to_owned()),
        ("TYPE", |it| it.1.to_owned()),
        ("COUNT", |it| it.2.to_owned()),
    ];
}

#[test]
fn columns_are_as_wide_as_their_longest_cell() {
    let rows = [Typed("a/long/name", "-", "7"), Typed("b", "x", "1.5")];
    let expected = "\
NAME         TYPE  COUNT
a/long/name  -         7
b            x       1.5";
    assert_eq!(Table(&rows).to_string(), expected);
    let rows = [Named("a/long/name", "1"), Named("b", "-")];
    let expected = "\
NODE         HZ
a/long/name   1
b             -";
    assert_eq!(Table(&rows).to_string(), expected);
    assert_eq!(Table::<Named>(&[]).to_string(), "NODE  HZ");
}

#[test]
fn a_stream_repeats_its_headings_when_it_widens() {
    let mut stream = Stream::new(1);
    let expected = ["NODE            HZ", "a             1.00"];
    assert_eq!(stream.lines(&[Named("a", "1.00")]), expected);
    assert_eq!(stream.lines(&[Named("b", "-")]), ["b                -"]);
    let wider = stream.lines(&[Named("a-long-name", "12345678.90")]);
    assert_eq!(
        wider,
        ["NODE                  HZ", "a-long-name  12345678.90"]
    );
}
