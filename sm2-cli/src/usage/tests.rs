use super::*;

fn line(arguments: &[&str]) -> String {
    let arguments: Vec<_> = arguments.iter().map(OsString::from).collect();
    let error = Cli::try_parse_from(&arguments).unwrap_err();
    one_line(&error, &arguments)
}

#[test]
fn every_wrong_usage_is_one_line() {
    for (arguments, expected) in [
        (
            &["sm2", "topic", "pub"][..],
            "the following required arguments were not provided: --from <PATH|-> <NAME> \
             (see `sm2 topic pub --help`)",
        ),
        (
            &["sm2", "topic", "ecko"],
            "unrecognized subcommand 'ecko' tip: a similar subcommand exists: 'echo' \
             (see `sm2 topic --help`)",
        ),
        (
            &["sm2", "demo", "--rate", "0"],
            "invalid value '0' for '--rate <HZ>': give a number above 0, such as 30 or 0.5 \
             (see `sm2 demo --help`)",
        ),
    ] {
        assert_eq!(line(arguments), expected);
    }
}

#[test]
fn a_bad_name_shows_the_grammar() {
    let line = line(&["sm2", "topic", "echo", "two words"]);
    assert!(line.contains("byte 3"), "{line}");
    assert!(line.contains("A-Z a-z 0-9 _ -"), "{line}");
    assert!(!line.contains('\n'), "{line}");
}
