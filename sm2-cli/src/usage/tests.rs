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
            "the following required arguments were not provided: <--from <PATH|->|--value <JSON>> <NAME> \
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
    assert!(line.contains("' ' is none of these"), "{line}");
    assert!(line.contains("A-Z a-z 0-9 _ -"), "{line}");
    assert!(!line.contains('\n'), "{line}");
}

#[test]
fn a_link_of_another_name_is_a_command() {
    let named = |program: &str| {
        let arguments = by_name_of_program(vec![program.into(), "--help".into()]);
        let words: Vec<_> = arguments.iter().map(|it| it.to_str().unwrap()).collect();
        words[1..].join(" ")
    };
    assert_eq!(named("/usr/bin/sm2-manager"), "manager --help");
    assert_eq!(named("sm2-gateway"), "gateway --help");
    for other in ["sm2", "/opt/sm2-manager/sm2", "sm2-managers"] {
        assert_eq!(named(other), "--help");
    }
    let version = vec!["sm2-manager".into(), "--version".into()];
    assert_eq!(by_name_of_program(version.clone()), version);
    assert_eq!(by_name_of_program(Vec::new()), Vec::<OsString>::new());
}
