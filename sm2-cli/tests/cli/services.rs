//! `sm2 service list`, `info` and `call`.

use std::{
    io::Write,
    process::Stdio,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::Duration,
};

use nix::sys::signal::Signal;
use serde_json::json;
use sm2_node::{Message, Node};

use crate::common::{Domain, Running, SOON, cells, noise, until};

/// Answers each request with the result of `answer` while `body` runs.
fn serving<Q, R>(
    node: &Node,
    service: &str,
    answer: impl Fn(&Q) -> Result<Box<R>, String> + Sync,
    body: impl FnOnce(),
) where
    Q: Message + ?Sized,
    R: Message + ?Sized,
{
    let server = node.server::<Q, R>(service).unwrap();
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        let (over, answer) = (&over, &answer);
        scope.spawn(move || {
            while !over.load(Ordering::Relaxed) {
                let request = server.recv_timeout(Duration::from_millis(20)).unwrap();
                let Some(request) = request else { continue };
                // A reply fails if the client is gone.
                match answer(&request) {
                    Ok(reply) => drop(request.reply(&reply)),
                    Err(reason) => drop(request.fail(&reason)),
                }
            }
        });
        let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(body));
        over.store(true, Ordering::Relaxed);
        if let Err(panic) = ended {
            std::panic::resume_unwind(panic);
        }
    });
}

fn sum(numbers: &[f64]) -> Result<Box<f64>, String> {
    match numbers {
        [] => Err("nothing\n\x1b[2Jto add".into()),
        numbers => Ok(Box::new(numbers.iter().sum())),
    }
}

#[test]
fn a_call_takes_and_prints_values() {
    let domain = Domain::new();
    let node = domain.node("adder");
    serving::<[f64], f64>(&node, "math/sum", sum, || {
        let call = domain.run(&["service", "call", "math/sum", "[1, 2, 3.5]"]);
        assert_eq!(
            (call.code(), call.stdout()),
            (0, "6.5\n".into()),
            "{call:?}"
        );
        // A client notes the time of its call, which is not a delay.
        let client = node.client::<[f64], f64>("math/sum").unwrap();
        let sum = client.call_timeout(&[1.0, 2.0], SOON).unwrap();
        assert_eq!(*sum, 3.0);
        let link = &domain.json(&["snapshot"])["links"][0];
        assert_eq!(link["taken"]["messages"], 1, "{link}");
        assert!(link["taken"]["delay_p50_ms"].is_null(), "{link}");
        let answer = domain.json(&["service", "call", "/math/sum", "[-1, 0.5]"]);
        assert_eq!(answer["value"], -0.5, "{answer}");
        assert_eq!(answer["server"], "adder");
        assert_eq!(answer["service"], "math/sum");
        assert_eq!(answer["len_bytes"], 8);
        let hex = domain.run(&["service", "call", "math/sum", "[1]", "--hex"]);
        assert_eq!(hex.stdout(), "000000000000f03f\n");
        let raw = domain.run(&["service", "call", "math/sum", "[1]", "--raw"]);
        assert_eq!(raw.stdout(), "8 bytes: 00 00 00 00 00 00 f0 3f\n");

        // An error of the server, a value of another type, and invalid JSON.
        let failed = domain.run(&["service", "call", "math/sum"]);
        failed.failed(1, &["math/sum", "nothing\\n\\u{1b}[2Jto add"]);
        let wrong = domain.run(&["service", "call", "math/sum", "{\"a\": 1}"]);
        wrong.failed(1, &["not a message of type", "expected", "object"]);
        let broken = domain.run(&["service", "call", "math/sum", "[1,"]);
        broken.failed(2, &["not JSON", "quote it"]);
        let mistyped = ["service", "call", "mth/sum", "[1]", "--timeout", "200ms"];
        domain
            .run(&mistyped)
            .failed(1, &["mth/sum has no server", "did you mean math/sum?"]);
    });
}

#[test]
fn services_are_listed_and_shown() {
    let domain = Domain::new();
    assert_eq!(domain.json(&["service", "list"])["services"], json!([]));
    let node = domain.node("adder");
    serving::<[f64], f64>(&node, "sum", sum, || {
        let list = domain.json(&["service", "list"]);
        let service = &list["services"][0];
        assert_eq!(service["name"], "sum");
        assert_eq!(service["request"]["name"], "f64-list");
        assert_eq!(service["reply"]["name"], "f64");
        assert_eq!([&service["servers"], &service["clients"]], [1, 0]);
        let text = domain.run(&["service", "list"]).stdout();
        let lines: Vec<_> = text.lines().map(cells).collect();
        let expected = [
            ["SERVICE", "REQUEST", "REPLY", "SERVERS", "CLIENTS", "LINKS"],
            ["sum", "f64-list", "f64", "1", "0", "0"],
        ];
        assert_eq!(lines, expected);

        let info = domain.json(&["service", "info", "sum"]);
        assert_eq!(info["request"]["schema"], "plain:list[f64]");
        assert_eq!(info["request"]["hash"], service["request"]["hash"]);
        assert_eq!(info["interfaces"][0]["request"], service["request"]);
        assert_eq!(info["interfaces"][0]["node"], "adder");
        assert_eq!(info["interfaces"][0]["kind"], "server");
        let text = domain.run(&["service", "info", "sum"]).stdout();
        assert!(text.contains("request schema  plain:list[f64]"), "{text}");
        let unknown = domain.run(&["service", "info", "summ"]);
        unknown.failed(1, &["no service summ", "did you mean sum?"]);
    });
    assert_eq!(domain.json(&["service", "list"])["services"], json!([]));
}

#[test]
fn bytes_go_in_and_come_out() {
    let domain = Domain::new();
    let node = domain.node("echo");
    let echo = |bytes: &[u8]| Ok(bytes.to_vec().into_boxed_slice());
    serving::<[u8], [u8]>(&node, "echo", echo, || {
        let file = domain.path("request");
        std::fs::write(&file, noise(5, 100_000)).unwrap();
        let from = file.to_str().unwrap();
        let hex = domain.run(&["service", "call", "echo", "--from", from, "--hex"]);
        let expected: String = noise(5, 100_000)
            .iter()
            .map(|it| format!("{it:02x}"))
            .collect();
        assert!(hex.stdout().trim_end() == expected);
        let mut command = domain.command(&["service", "call", "echo", "--from", "-"]);
        let mut piped = Running::start(command.stdin(Stdio::piped()));
        piped
            .child()
            .stdin
            .take()
            .unwrap()
            .write_all(b"hi\n")
            .unwrap();
        assert_eq!(piped.finish().stdout(), "hi\n");
        let text = domain.run(&["service", "call", "echo", "\"text\""]);
        assert_eq!(text.stdout(), "text\n");
        let missing = domain.run(&["service", "call", "echo", "--from", "/no/such"]);
        missing.failed(1, &["cannot read /no/such", "check the path"]);
    });
}

#[test]
fn nobody_answers() {
    let domain = Domain::new();
    let none = domain.run(&["service", "call", "none", "--timeout", "100ms"]);
    none.failed(1, &["service none has no server"]);
    // A slow server, and a person who presses Ctrl-C.
    let node = domain.node("slow");
    let _server = node.server::<[u8], [u8]>("slow").unwrap();
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                node.spin_once_timeout(Duration::from_millis(20)).unwrap();
            }
        });
        // The time-out covers the start of the command, which takes longer on a busy machine.
        let mut timeout_ms = 300;
        until("a deadline passes on a link", || {
            let timeout = format!("{timeout_ms}ms");
            let late = domain.run(&["service", "call", "slow", "--timeout", &timeout]);
            let said = late.stderr();
            timeout_ms *= 2;
            late.failed(1, &["slow"]);
            let is_late = said.contains("slow did not reply before the deadline");
            assert!(is_late || said.contains("slow has no server"), "{said}");
            is_late
        });
        let stopped = domain.start(&["service", "call", "slow", "--timeout", "60s"]);
        let name = format!("node:sm2-call-{} links==1", stopped.pid());
        let linked = domain.run(&["wait", &name, "--timeout", "60s"]);
        stopped.signal(Signal::SIGINT);
        let stopped = stopped.finish();
        over.store(true, Ordering::Relaxed);
        assert_eq!(linked.code(), 0, "{linked:?}");
        assert_eq!(stopped.code(), 130, "{stopped:?}");
    });
}
