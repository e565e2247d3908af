//! Which requests are refused, and for which reason.

use hyper::header::HeaderValue;

use super::*;

fn access(address: &str) -> Access {
    Access {
        address: address.parse().unwrap(),
        token: "cafe".into(),
    }
}

fn check(
    of: &Access,
    host: &'static str,
    origin: Option<&'static str>,
    path: &str,
) -> Result<String, Refused> {
    let mut headers = HeaderMap::new();
    headers.insert(HOST, HeaderValue::from_static(host));
    if let Some(origin) = origin {
        headers.insert(ORIGIN, HeaderValue::from_static(origin));
    }
    of.check(&headers, &path.parse().unwrap())
        .map(str::to_owned)
}

#[test]
fn the_page_of_the_printed_url_is_answered() {
    let local = access("127.0.0.1:80");
    for host in [
        "127.0.0.1:80",
        "localhost:80",
        "LocalHost:8000",
        "localhost",
    ] {
        assert_eq!(
            check(&local, host, None, "/cafe/api/domain"),
            Ok("api/domain".into()),
            "{host}"
        );
    }
    let own = Some("http://localhost:80");
    assert_eq!(
        check(&local, "localhost:80", own, "/cafe/"),
        Ok(String::new())
    );
    let v6 = access("[::1]:80");
    assert_eq!(
        check(&v6, "[::1]:80", Some("http://[::1]:80"), "/cafe/"),
        Ok(String::new())
    );
    let all = access("0.0.0.0:80");
    assert_eq!(
        check(&all, "192.168.1.7:80", None, "/cafe/"),
        Ok(String::new())
    );
}

#[test]
fn other_hosts_are_refused() {
    let local = access("127.0.0.1:80");
    for host in [
        "evil.example",
        "localhost.evil.example:80",
        "127.0.0.2:80",
        "192.168.1.7",
        "",
        "a b",
    ] {
        assert_eq!(
            check(&local, host, None, "/cafe/"),
            Err(Refused::Host),
            "{host}"
        );
    }
    assert_eq!(
        check(&access("0.0.0.0:80"), "evil.example", None, "/cafe/"),
        Err(Refused::Host)
    );
    assert_eq!(
        local.check(&HeaderMap::new(), &"/cafe/".parse().unwrap()),
        Err(Refused::Host)
    );
}

#[test]
fn other_origins_are_refused() {
    let local = access("127.0.0.1:80");
    for origin in [
        "null",
        "http://evil.example",
        "http://localhost:3000",
        "https://localhost:80",
        "",
    ] {
        assert_eq!(
            check(&local, "localhost:80", Some(origin), "/cafe/"),
            Err(Refused::Origin),
            "{origin}"
        );
    }
}

#[test]
fn other_tokens_are_refused() {
    let local = access("127.0.0.1:80");
    for path in [
        "/",
        "/cafe",
        "/caff/",
        "/caf/",
        "/cafee/",
        "//",
        "/CAFE/",
        "/?token=cafe",
    ] {
        assert_eq!(
            check(&local, "localhost", None, path),
            Err(Refused::Token),
            "{path}"
        );
    }
}

#[test]
fn each_token_is_new() {
    let url = || Access::new("127.0.0.1:80".parse().unwrap()).unwrap().url();
    let (one, other) = (url(), url());
    assert_ne!(one, other);
    assert_eq!(one.len(), "http://127.0.0.1:80//".len() + 2 * TOKEN_BYTES);
}
