//! The work of shipped programs while a call of one of them fails.

use std::{
    fs,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::Duration,
};

use nix::sys::signal::Signal;
use sm2_node::Node;
use sm2_proto::link::End as LinkEnd;
use sm2_tests::process::Process;

use crate::{
    programs::{self, End, done, end_of},
    strace::Victim,
    world::{Published, To, World, gapless, serves},
};

/// A publisher of files registers, publishes and ends.
pub(crate) fn publish(victim: &Victim) -> Vec<String> {
    exchange([victim, &Victim::NONE], To::Output)
}

/// A subscriber registers, prints messages and ends.
pub(crate) fn subscribe(victim: &Victim) -> Vec<String> {
    exchange([&Victim::NONE, victim], To::Output)
}

/// A subscriber writes each message to a file.
pub(crate) fn files(victim: &Victim) -> Vec<String> {
    exchange([&Victim::NONE, victim], To::Files)
}

fn exchange(victims: [&Victim; 2], to: To) -> Vec<String> {
    let mut world = World::start();
    if world.exchange(victims, to) == End::Failed {
        world.exchange_at_last(to);
    }
    world.end(&[])
}

/// A Manager starts, serves and ends.
pub(crate) fn manager(victim: &Victim) -> Vec<String> {
    let mut world = World::start_with(victim);
    world.exchange_at_last(To::Output);
    world.end(&[victim])
}

/// A client calls a server of this process.
pub(crate) fn call(victim: &Victim) -> Vec<String> {
    let world = World::start();
    let file = world.domain.folder().join("messages").join("1");
    let request = fs::read_to_string(&file).expect("a file");
    let node = Node::builder("worker").socket(world.domain.socket());
    let node = node.connect().expect("a node");
    let server = node.server::<[u8], [u8]>("service").expect("a server");
    let over = AtomicBool::new(false);
    let call = || {
        let mut command = world.command(&["service", "call", "service"]);
        command.arg("--from").arg(&file);
        command
    };
    thread::scope(|scope| {
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                let request = server.recv_timeout(Duration::from_millis(5));
                if let Some(request) = request.expect("a request") {
                    let reply = request.to_vec();
                    // Fails if the client has gone.
                    let _ = request.reply(&reply);
                }
            }
        });
        let called = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            let (end, mut said) = end_of(&mut victim.start(call()));
            if end == End::Failed {
                said = done(&mut Victim::NONE.start(call()));
            }
            assert!(said.lines.join("\n") == request, "another reply");
        }));
        over.store(true, Ordering::Relaxed);
        if let Err(panic) = called {
            std::panic::resume_unwind(panic);
        }
    });
    for link in server.links() {
        assert!(!matches!(link.end, Some(LinkEnd::Violation(_))), "{link:?}");
    }
    drop(server);
    drop(node);
    world.end(&[])
}

/// A Manager takes the domain over.
pub(crate) fn take_over(victim: &Victim) -> Vec<String> {
    change([&Victim::NONE, victim])
}

/// A Manager starts, serves, and hands the domain over.
pub(crate) fn hand_over(victim: &Victim) -> Vec<String> {
    change([victim, &Victim::NONE])
}

/// The second Manager takes the place of the first one. The link stays, and a new one is made.
fn change([first, second]: [&Victim; 2]) -> Vec<String> {
    let mut world = World::start_with(first);
    let echo = ["topic", "echo", "topic", "--reliable", "--json"];
    let mut listener = Victim::NONE.start(world.command(&echo));
    let publish = [
        "topic",
        "pub",
        "topic",
        "--reliable",
        "--value",
        "\"hello\"",
    ];
    let publish = [&publish[..], &["--loop", "--rate", "200"]].concat();
    let mut talker = Victim::NONE.start(world.command(&publish));
    listener.expect_line();
    let successor = world.successor(second).unwrap_or_else(|| {
        // It may have failed before the Manager handed over, or after that.
        let successor = world.successor(&Victim::NONE);
        successor.expect("a Manager without a fault")
    });
    world.adopt(successor);
    let late = ["--count", "3", "--wait-manager", "30s"];
    let mut late = Victim::NONE.start(world.command(&[&echo[..], &late].concat()));
    let late = done(&mut late);
    assert_eq!(gapless(&late), 3, "{}", late.stderr);
    talker.signal(Signal::SIGINT);
    let said = done(&mut talker);
    let published = Published::of(&said).expect("a summary");
    listener.signal(Signal::SIGINT);
    let heard = done(&mut listener);
    // The first line was taken above.
    let received = gapless(&heard) + 1;
    let missing = published.missing();
    assert!(
        received + missing >= published.messages,
        "{published:?}, {received} received: {}",
        heard.stderr
    );
    world.end(&[first, second])
}

/// A gateway starts, connects to another one, carries messages and ends.
pub(crate) fn gateway(victim: &Victim) -> Vec<String> {
    let (near, far) = (World::start(), World::start());
    let [near_id, far_id] = [&near, &far].map(|world| {
        let key = world.domain.folder().join("key");
        let mut command = programs::gateway(&["keygen"]);
        command.arg(key);
        done(&mut Victim::NONE.start(command)).lines.remove(0)
    });
    let mut far_gateway = start(&far, &Victim::NONE, ("far", "near", &near_id), "")
        .expect("a gateway without a fault");
    let log = far_gateway.stderr();
    let address = log.split("address=").nth(1).expect("an address");
    let address = address.split_whitespace().next().expect("an address");
    let addresses = format!("addresses = [\"{address}\"]\n");
    let peer = ("near", "far", &*far_id);
    let near_gateway = start(&near, victim, peer, &addresses);
    let mut near_gateway = near_gateway.unwrap_or_else(|| {
        start(&near, &Victim::NONE, peer, &addresses).expect("a gateway without a fault")
    });
    let echo = ["topic", "echo", "topic", "--json", "--count", "3"];
    let mut listener = Victim::NONE.start(far.command(&echo));
    let publish = ["topic", "pub", "topic", "--value", "\"hello\"", "--loop"];
    let publish = [&publish[..], &["--rate", "100"]].concat();
    let mut talker = Victim::NONE.start(near.command(&publish));
    let heard = done(&mut listener);
    assert_eq!(gapless(&heard), 3, "{}", heard.stderr);
    assert!(
        heard
            .lines
            .iter()
            .all(|it| it.contains("\"text\":\"hello\""))
    );
    talker.signal(Signal::SIGINT);
    done(&mut talker);
    for gateway in [&mut near_gateway, &mut far_gateway] {
        assert!(!gateway.has_ended(), "{}", gateway.stderr());
        gateway.signal(Signal::SIGTERM);
        done(gateway);
    }
    [near.end(&[]), far.end(&[])].concat()
}

/// Starts a gateway with one peer. `None` if it failed, and said why.
fn start(
    world: &World,
    victim: &Victim,
    (name, peer, id): (&str, &str, &str),
    addresses: &str,
) -> Option<Process> {
    let text = format!(
        "name = \"{name}\"\nlisten = \"127.0.0.1:0\"\nkey = \"key\"\nsocket = \"domain.sock\"\n\
         [[peer]]\nname = \"{peer}\"\nid = \"{id}\"\n{addresses}\
         [[rule]]\naction = \"allow\"\nnames = \"**\"\n"
    );
    let config = world.domain.folder().join("gateway.toml");
    fs::write(&config, text).expect("a file");
    let mut command = programs::gateway(&["run"]);
    command.arg(config);
    serves(victim.start(command), "gateway started")
}
