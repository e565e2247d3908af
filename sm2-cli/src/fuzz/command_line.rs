//! Input of people: command lines, names, sizes, times, expressions, and the environment.

use std::{
    ffi::{OsStr, OsString},
    os::unix::ffi::{OsStrExt, OsStringExt},
    path::Path,
};

use clap::error::ErrorKind;
use sm2_io::domain_socket::{DomainSocketError, MAX_DOMAIN_BYTES, MAX_PATH_BYTES, socket_path_in};
use sm2_proto::limits::{MESSAGE_MAX, NAME_MAX};

use crate::{
    args,
    command::Command,
    names::Selector,
    size::Size,
    time::{Span, span, span_or_zero},
    usage, wait_for,
};

/// Splits the input into words at NUL bytes. Parses all of them as a command line, each of them as every kind
/// of argument, and the first three as environment variables. Runs nothing.
pub(super) fn words(data: &[u8]) {
    let words: Vec<&[u8]> = data.split(|&byte| byte == 0).collect();
    command_line(&words);
    for text in words.iter().filter_map(|word| str::from_utf8(word).ok()) {
        name(text);
        size(text);
        time(text);
        selector(text);
        wait_for::fuzz::expression(text);
    }
    environment(&words);
}

/// The result is a command, or an error of one line.
fn command_line(words: &[&[u8]]) {
    let words = words.iter().map(|word| OsString::from_vec(word.to_vec()));
    let arguments: Vec<OsString> = std::iter::once("sm2".into()).chain(words).collect();
    match usage::read(&arguments) {
        Ok(Command::Manager(arguments)) => sm2_manager::program::fuzz::check(&arguments),
        Ok(_) => {}
        Err(error) => {
            let line = usage::one_line(&error, &arguments);
            let help = matches!(
                error.kind(),
                ErrorKind::DisplayHelp
                    | ErrorKind::DisplayVersion
                    | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
            );
            assert!(help || !line.contains('\n'), "{line:?}");
            assert!(line.contains("--help`)"), "{line:?}");
        }
    }
}

/// The grammar of SM2-NAM-001, implemented a second time.
//= SM2-NAM-001 fuzz
fn name(text: &str) {
    let bare = text.strip_prefix('/').unwrap_or(text);
    let legal = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let segments = |text: &str| {
        text.split('/')
            .all(|it| !it.is_empty() && it.chars().all(legal))
    };
    let is_name = bare.len() <= NAME_MAX && segments(bare);
    match args::name(text) {
        Ok(name) => assert!(is_name && name.as_str() == bare, "{text:?}"),
        Err(error) => assert!(!is_name && !error.contains('\n'), "{text:?}: {error}"),
    }
}

fn size(text: &str) {
    if let Ok(size) = text.parse::<Size>() {
        assert!((1..=MESSAGE_MAX).contains(&size.0));
        assert_eq!(format!("{}B", size.0).parse(), Ok(size));
        assert!(size.to_string().ends_with(char::is_alphabetic));
    }
}

fn time(text: &str) {
    let read = span_or_zero(text);
    match (&read, span(text)) {
        (Ok(span), Ok(same)) => assert!(*span == same && !span.is_zero()),
        (Ok(span), Err(_)) => assert!(span.is_zero()),
        (Err(error), again) => assert_eq!(again.as_ref(), Err(error)),
    }
    if let Ok(span) = read {
        assert_eq!(span_or_zero(&format!("{}ns", span.as_nanos())), Ok(span));
        assert!(Span(span).to_string().ends_with(char::is_alphabetic));
    }
}

fn selector(text: &str) {
    if let Ok(selector) = Selector::parse(text) {
        assert_eq!(Selector::parse(&selector.to_string()), Ok(selector));
    }
}

/// The path of a socket, from variables with any values.
//= SM2-TRN-001, SM2-TRN-002 fuzz
fn environment(words: &[&[u8]]) {
    let value = |at: usize| words.get(at).map(|word| OsStr::from_bytes(word).to_owned());
    let variable = |name: &str| match name {
        "SM2_SOCKET" => value(0),
        "SM2_DOMAIN" => value(1),
        "XDG_RUNTIME_DIR" => value(2),
        other => panic!("{other} is not one of the three"),
    };
    let option = words.get(3).and_then(|word| str::from_utf8(word).ok());
    for domain in [None, option] {
        match socket_path_in(domain, variable) {
            Ok(path) => path_is_as_said(&path, domain, variable),
            Err(DomainSocketError::DomainName { name }) => assert!(!is_domain(&name), "{name:?}"),
            Err(DomainSocketError::PathTooLong { len_bytes, .. }) => {
                assert!(len_bytes > MAX_PATH_BYTES);
            }
            Err(other) => panic!("{other}"),
        }
    }
}

fn path_is_as_said(path: &Path, domain: Option<&str>, of: impl Fn(&str) -> Option<OsString>) {
    let of = |name| of(name).filter(|value| !value.is_empty());
    assert!(path.as_os_str().len() <= MAX_PATH_BYTES);
    if let (None, Some(socket)) = (domain, of("SM2_SOCKET")) {
        assert_eq!(path.as_os_str(), socket);
        return;
    }
    let chosen = of("SM2_DOMAIN").map(|name| name.to_string_lossy().into_owned());
    let domain = domain.map_or_else(|| chosen.unwrap_or("default".into()), str::to_owned);
    assert!(is_domain(&domain), "{domain:?}");
    assert_eq!(
        path.file_name(),
        Some(OsStr::new(&format!("{domain}.sock")))
    );
    let runtime = of("XDG_RUNTIME_DIR").filter(|it| it.as_bytes().starts_with(b"/"));
    let folder = Path::new(runtime.as_deref().unwrap_or(OsStr::new("/run"))).join("sm2");
    assert_eq!(path.parent(), Some(&*folder));
}

fn is_domain(name: &str) -> bool {
    let legal = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    (1..=MAX_DOMAIN_BYTES).contains(&name.len()) && name.chars().all(legal)
}
