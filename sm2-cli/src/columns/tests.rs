use super::*;

fn row<const N: usize>(cells: [&str; N]) -> [String; N] {
    cells.map(str::to_owned)
}

#[test]
fn columns_are_as_wide_as_their_longest_cell() {
    let mut table = Columns::new(["NAME", "TYPE", "COUNT"]);
    table.push(row(["a/long/name", "-", "7"]));
    table.push(row(["b", "x", "1.5"]));
    let expected = "\
NAME         TYPE  COUNT
a/long/name  -         7
b            x       1.5";
    assert_eq!(table.to_string(), expected);
}

#[test]
fn a_stream_repeats_its_headings_when_it_widens() {
    let mut stream = Stream::new(["NODE", "HZ"], 1);
    let expected = ["NODE            HZ", "a             1.00"];
    assert_eq!(stream.lines(&[row(["a", "1.00"])]), expected);
    assert_eq!(stream.lines(&[row(["b", "-"])]), ["b                -"]);
    let wider = stream.lines(&[row(["a-long-name", "12345678.90"])]);
    assert_eq!(
        wider,
        ["NODE                  HZ", "a-long-name  12345678.90"]
    );
}
