//! Made-up tests that load can break, or that can wait for ever.

use std::path::Path;

use super::limits::hasty_tests;

/// The findings in a test of these lines, without the path: `3: text`.
fn found(lines: &str) -> Vec<String> {
    found_in("a/tests/a.rs", &format!("fn a() {{\n{lines}\n}}"))
}

fn found_in(path: &str, text: &str) -> Vec<String> {
    let findings = hasty_tests(Path::new(path), text);
    let show = findings.iter().map(ToString::to_string);
    show.map(|it| it.strip_prefix(&format!("{path}:")).unwrap().to_owned())
        .collect()
}

/// How many lines of a test of these lines break a rule.
fn count(lines: &str) -> usize {
    found(lines).len()
}

#[test]
fn assertions_on_elapsed_time_are_found() {
    let text = "2: an assertion on elapsed time: assert an order, or count";
    assert_eq!(found("assert!(start.elapsed() < LIMIT, \"late\");"), [text]);
    for hasty in [
        "assert!(x && (start.elapsed().as_secs_f64() <= 0.5));",
        "assert!(LIMIT > start.elapsed());",
        "let took = start.elapsed(); assert!(took < LIMIT, \"{took:?}\");",
        "let ms = start.elapsed().as_millis() as u64; let all = ms + 1; assert!(all < 5);",
        "assert!((A..B).contains(&start.elapsed()));",
        "run(|| { for _ in 0..2 { debug_assert!(start.elapsed() < LIMIT); } });",
        "vec![{ assert!(start.elapsed() < LIMIT) }];",
    ] {
        assert_eq!(count(hasty), 1, "{hasty}");
    }
    for accepted in [
        "assert!(start.elapsed() >= LIMIT);",
        "let took = start.elapsed(); assert!(count < 5, \"{took:?}\");",
        "println!(\"{:?}\", start.elapsed());",
        "if start.elapsed() > LIMIT { return; }",
    ] {
        assert_eq!(count(accepted), 0, "{accepted}");
    }
    let two = "fn a() { let x = s.elapsed(); }\nfn b() { let x = 1; assert!(x < 2); }";
    assert_eq!(found_in("a/tests/a.rs", two), [""; 0]);
}

#[test]
fn short_limits_on_what_has_to_succeed_are_found() {
    let text = "2: a limit of 5000 ms on what has to succeed: use sm2_test_support::SOON";
    let five = "Duration::from_secs(5)";
    let line = format!("a.wait_for_peers_timeout(1, {five}).unwrap();");
    assert_eq!(found(&line), [text]);
    for hasty in [
        "a.recv_timeout(Duration::from_millis(5)).unwrap().unwrap();",
        "a.recv_timeout(Duration::from_micros(5))?.expect(\"it\");",
        "a.call_timeout(&b, Duration::from_secs(59)).expect(\"a reply\");",
        "assert!(a.recv_timeout(Duration::from_secs(1)).unwrap().is_some());",
        "const SHORT: Duration = Duration::from_secs(1); a.call_timeout(b, SHORT)?;",
        "Node::new(\"a\").manager_timeout(Duration::from_millis(9)).socket(b).connect().unwrap();",
    ] {
        assert_eq!(count(hasty), 1, "{hasty}");
    }
    for accepted in [
        "a.recv_timeout(Duration::from_secs(60)).unwrap().unwrap();",
        "a.recv_timeout(SOON).unwrap().unwrap();",
        "a.recv_timeout(Duration::from_millis(5)).unwrap();",
        "let sample = a.recv_timeout(Duration::from_millis(5));",
        "assert!(!a.recv_timeout(Duration::from_millis(5)).unwrap().is_some());",
        "a.call_timeout(&b, Duration::from_millis(1)).unwrap_err();",
        "let call = a.send_timeout(&b, Duration::from_millis(1)).unwrap();",
        "Node::new(\"a\").manager_timeout(SOON).connect().unwrap();",
    ] {
        assert_eq!(count(accepted), 0, "{accepted}");
    }
    let channel =
        "use std::sync::mpsc;\nfn a() { b.recv_timeout(Duration::from_secs(1)).unwrap(); }";
    assert_eq!(found_in("a/tests/a.rs", channel).len(), 1);
    let local = "const SOON: Duration = Duration::from_secs(60);";
    assert_eq!(found_in("a/src/b_tests.rs", local).len(), 1);
}

#[test]
fn waits_without_a_limit_are_found() {
    let text = "2: a wait without a limit: use one with sm2_test_support::SOON";
    assert_eq!(found("receiver.recv().unwrap();"), [text]);
    for endless in [
        "let _ = self.child.wait();",
        "self.0.wait().unwrap();",
        "child.kill().unwrap(); receiver.recv().unwrap();",
        "assert!(command.spawn().unwrap().wait().unwrap().success());",
        "assert_eq!(child.wait().unwrap().code(), Some(0));",
    ] {
        assert_eq!(count(endless), 1, "{endless}");
    }
    for bounded in [
        "a.recv().await.unwrap();",
        "timeout(SOON, a.recv()).await;",
        "a.recv(&mut buffer).unwrap();",
        "child.kill().unwrap(); child.wait().unwrap();",
        "call.wait().unwrap();",
        "thread.join().unwrap();",
    ] {
        assert_eq!(count(bounded), 0, "{bounded}");
    }
}

#[test]
fn all_tests_are_looked_at_and_nothing_else() {
    let wait = "fn a() { b.recv(); }";
    for path in [
        "a/tests/b.rs",
        "a/tests/b/c.rs",
        "a/src/tests.rs",
        "a/src/b_tests.rs",
    ] {
        assert_eq!(found_in(path, wait).len(), 1, "{path}");
    }
    for path in [
        "a/src/b.rs",
        "tests/support/src/a.rs",
        "tests/src/bin/soak/a.rs",
    ] {
        assert_eq!(found_in(path, wait), [""; 0], "{path}");
    }
    let module = format!("{wait}\n#[cfg(test)]\nmod tests {{ {wait} }}");
    let line = "3: a wait without a limit: use one with sm2_test_support::SOON";
    assert_eq!(found_in("a/src/b.rs", &module), [line]);
}
