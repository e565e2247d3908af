use super::*;

#[derive(Debug, clap::Parser)]
struct Command {
    #[command(flatten)]
    arguments: Arguments,
}

fn split(options: &[&str]) -> Option<Split> {
    let words = ["record", "--all"].iter().chain(options);
    <Command as clap::Parser>::parse_from(words)
        .arguments
        .split()
}

#[test]
fn a_recording_is_split_by_size_time_or_the_limit_of_all_files() {
    assert_eq!(split(&[]), None);
    let bytes = |bytes| Split {
        bytes: Some(bytes),
        time: None,
    };
    assert_eq!(split(&["--split-size", "1MB"]), Some(bytes(1_000_000)));
    // The oldest of eight files is removed: an eighth of the limit.
    assert_eq!(split(&["--max-size", "80MB"]), Some(bytes(10_000_000)));
    let both = |size| split(&["--max-size", "80MB", "--split-size", size]);
    assert_eq!(both("9MB"), Some(bytes(9_000_000)));
    assert_eq!(both("11MB"), Some(bytes(10_000_000)));
    let time = Split {
        bytes: None,
        time: Some(Duration::from_secs(60)),
    };
    assert_eq!(split(&["--split-time", "1m"]), Some(time));
}
