//! A table of environments and the resulting socket paths.

use std::ffi::OsString;
use std::os::unix::ffi::OsStringExt;

use sm2_io::DomainSocketError;
use sm2_io::domain_socket::{MAX_PATH_BYTES, socket_path_in};

fn path(domain: Option<&str>, environment: &[(&str, &str)]) -> Result<String, DomainSocketError> {
    let variable = |name: &str| {
        let found = environment.iter().find(|(variable, _)| *variable == name);
        found.map(|(_, value)| OsString::from(value))
    };
    socket_path_in(domain, variable).map(|path| path.to_str().unwrap().to_owned())
}

#[test]
fn the_table() {
    let (socket, domain, runtime) = ("SM2_SOCKET", "SM2_DOMAIN", "XDG_RUNTIME_DIR");
    type Row<'a> = (Option<&'a str>, &'a [(&'a str, &'a str)], &'a str);
    let rows: &[Row<'_>] = &[
        (None, &[], "/run/sm2/default.sock"),
        (None, &[(domain, "arm")], "/run/sm2/arm.sock"),
        (
            None,
            &[(runtime, "/run/user/7")],
            "/run/user/7/sm2/default.sock",
        ),
        (None, &[(runtime, "/r"), (domain, "arm")], "/r/sm2/arm.sock"),
        (
            None,
            &[(socket, "/tmp/x"), (runtime, "/r"), (domain, "arm")],
            "/tmp/x",
        ),
        // `SM2_DOMAIN` is ignored if `SM2_SOCKET` is set.
        (None, &[(socket, "x"), (domain, "not legal")], "x"),
        (
            Some("leg"),
            &[(socket, "/tmp/x"), (domain, "arm")],
            "/run/sm2/leg.sock",
        ),
        (
            Some("leg"),
            &[(runtime, "/r"), (domain, "arm")],
            "/r/sm2/leg.sock",
        ),
        (
            None,
            &[(socket, ""), (domain, ""), (runtime, "")],
            "/run/sm2/default.sock",
        ),
        (None, &[(runtime, "relative")], "/run/sm2/default.sock"),
    ];
    for (name, environment, expected) in rows {
        assert_eq!(
            path(*name, environment).unwrap(),
            *expected,
            "{name:?} {environment:?}"
        );
    }
}

#[test]
fn names_of_domains() {
    let longest = "x".repeat(64);
    for legal in ["a", "Az09_-", "-", &longest] {
        let expected = format!("/run/sm2/{legal}.sock");
        assert_eq!(path(Some(legal), &[]).unwrap(), expected);
    }
    let too_long = "x".repeat(65);
    for illegal in [
        "", ".", "..", "a/b", "a b", "a.b", "é", "a\0", "a\n", &too_long,
    ] {
        let result = path(Some(illegal), &[]);
        let refused =
            matches!(&result, Err(DomainSocketError::DomainName { name }) if name == illegal);
        assert!(refused, "{illegal:?}: {result:?}");
    }
    assert!(matches!(
        path(None, &[("SM2_DOMAIN", "a/b")]),
        Err(DomainSocketError::DomainName { .. })
    ));
    let not_utf8 =
        |name: &str| (name == "SM2_DOMAIN").then(|| OsString::from_vec(vec![b'a', 0xff]));
    assert!(matches!(
        socket_path_in(None, not_utf8),
        Err(DomainSocketError::DomainName { .. })
    ));
}

#[test]
fn paths_fit_an_address() {
    let fits = format!("/{}", "x".repeat(MAX_PATH_BYTES - 1));
    assert_eq!(path(None, &[("SM2_SOCKET", &fits)]).unwrap(), fits);
    let long = format!("{fits}x");
    let Err(error) = path(None, &[("SM2_SOCKET", &long)]) else {
        panic!("{long} was accepted");
    };
    assert!(matches!(
        &error,
        DomainSocketError::PathTooLong { len_bytes: 107, .. }
    ));
    assert!(
        error.to_string().contains("SM2_SOCKET"),
        "the error says what to do: {error}"
    );
    let deep = format!("/{}", "d".repeat(100));
    assert!(matches!(
        path(Some("arm"), &[("XDG_RUNTIME_DIR", &deep)]),
        Err(DomainSocketError::PathTooLong { .. })
    ));
}
