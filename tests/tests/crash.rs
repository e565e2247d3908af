//! Processes are killed at random moments. The others continue, or are told at once, and no
//! resources are leaked.

// Shows CLI-SURVIVE, MGR-RELEASE (test, full).

use std::{thread, time::Duration};

use sm2_tests::{
    actor::{Actor, number},
    census::Census,
    domain::TempDomain,
    eventually, in_time,
    process::{Process, actor},
    random::Random,
};

const ROLES: [&str; 4] = ["pub", "sub", "server", "client"];
/// How many processes are killed at random.
const KILLS: usize = if cfg!(feature = "slow") { 200 } else { 20 };

/// A node that works without pause, once the line `go` arrives.
fn storm(domain: &TempDomain, name: &str, role: &str, go: &str) -> Process {
    let mut command = actor("storm");
    command.arg("--socket").arg(domain.socket());
    command.args(["--name", name, "--role", role, "--go", go]);
    // The sizes of its messages.
    let seed = name.bytes().map(u64::from).sum::<u64>();
    command.args(["--seed", &seed.to_string()]);
    Process::start(command)
}

/// The nodes that are not killed: one of each role.
struct Survivors {
    all: [Process; 4],
    /// The descriptors and mappings of each process before its first declaration.
    baseline: [Census; 4],
}

impl Survivors {
    fn connect(domain: &TempDomain) -> Self {
        let all = ROLES.map(|role| storm(domain, &format!("survivor-{role}"), role, "false"));
        for survivor in &all {
            assert_eq!(survivor.expect_line(), "connected");
        }
        let baseline = all
            .each_ref()
            .map(|it| it.census_when_idle().and_counters(1));
        Self { all, baseline }
    }

    fn go(&mut self) {
        self.all.iter_mut().for_each(|survivor| survivor.say("go"));
        for survivor in &self.all {
            assert_eq!(survivor.expect_line(), "working");
        }
    }

    /// Ends their work. Returns the report of each.
    fn stop(&mut self) -> [String; 4] {
        let [publisher, subscriber, server, client] = &mut self.all;
        publisher.say("stop");
        let published = publisher.expect_line();
        // All messages arrive, including those that were published during the last kill.
        subscriber.say(&format!("stop {}", number(&published, "published")));
        let received = subscriber.expect_line();
        client.say("stop");
        let called = client.expect_line();
        server.say("stop");
        [published, received, server.expect_line(), called]
    }

    /// Asserts that the survivors hold only resources of each other: the subscriber holds the
    /// publisher's segments, and server and client hold those that they sent to each other.
    fn share_only_their_own(&self, sockets: usize) {
        let mut last = self.baseline.clone();
        let done = in_time(|| {
            last = self.all.each_ref().map(Process::census);
            let [publisher, subscriber, server, client] = &last;
            let segments = |census: &Census| census.of_kind("memfd:sm2-segment");
            let (ours, theirs) = (segments(server), segments(client));
            // There are three sizes of slots, and no segments remain where dead peers had slots.
            last.iter().all(|census| segments(census) <= 8)
                && publisher.mappings() == segments(publisher)
                && subscriber.mappings() == segments(publisher)
                && segments(subscriber) == 0
                && publisher.rings() == subscriber.rings()
                && publisher.rings() <= 1
                && (ours..=ours + theirs).contains(&server.mappings())
                && (theirs..=ours + theirs).contains(&client.mappings())
                && last
                    .iter()
                    .all(|census| census.of_kind("socket") == sockets)
        });
        let [publisher, subscriber, server, client] = last;
        assert!(
            done,
            "more is shared than among them:\n{publisher}\n{subscriber}\n{server}\n{client}"
        );
    }

    /// Withdraws their interfaces, and asserts that each process holds what it held at first.
    fn close(&mut self) {
        for survivor in &mut self.all {
            survivor.say("close");
            assert_eq!(survivor.expect_line(), "closed");
        }
        for (survivor, baseline) in self.all.iter().zip(&self.baseline) {
            baseline.restored(survivor.pid());
        }
    }
}

/// Kills a server that has a request of the surviving client.
fn kill_inside_a_call(domain: &TempDomain) {
    let mut holder = storm(domain, "holder", "holder", "true");
    for line in ["connected", "working", "holding"] {
        assert_eq!(holder.expect_line(), line);
    }
    holder.kill();
}

/// A publisher and a client whose peers die continue at once. Otherwise their waits would end in
/// errors that the actor does not expect.
//= SM2-SES-003, SM2-SES-006, SM2-OPN-009, SM2-SRV-004, SM2-LNK-009 sys
//= SM2-TRN-005, SM2-QOS-002, SM2-SRV-005 sys
#[test]
fn processes_killed_at_random_moments_leave_the_others_alone() {
    let mut random = Random::seeded();
    let domain = TempDomain::new();
    let manager = domain.manager();
    let mut survivors = Survivors::connect(&domain);
    let baseline = (manager.census_when_idle()).and_counters_in_their_places(ROLES.len());
    survivors.go();
    kill_inside_a_call(&domain);
    let victim = |role| storm(&domain, &format!("victim-{role}"), role, "true");
    let mut victims = ROLES.map(victim);
    for _ in 0..KILLS {
        // From before the session exists to the middle of its work.
        let most = random.choose(&[1, 3, 10, 20, 60]);
        thread::sleep(Duration::from_millis(random.within(0..most)));
        let index = random.within(0..ROLES.len() as u64) as usize;
        victims[index].kill();
        victims[index] = victim(ROLES[index]);
    }
    drop(victims);
    let reports = survivors.stop();
    println!("{}", reports.join("\n"));
    assert!(number(&reports[3], "failed") > 0, "{}", reports[3]);
    // Each survivor has two sockets: the session and its one link.
    survivors.share_only_their_own(2);
    survivors.close();
    baseline.restored(manager.pid());
    assert_eq!(domain.files(), ["domain.sock", "domain.sock.lock"]);
}

//= SM2-NOD-003 sys
#[test]
fn work_goes_on_without_the_manager() {
    let domain = TempDomain::new();
    let mut manager = domain.manager();
    let mut survivors = Survivors::connect(&domain);
    survivors.go();
    thread::sleep(Duration::from_millis(50));
    manager.kill();
    thread::sleep(Duration::from_millis(150));
    let [published, received, served, called] = survivors.stop();
    println!("{published}\n{received}\n{served}\n{called}");
    assert_eq!(number(&called, "failed"), 0);
    assert_eq!(number(&called, "replied"), number(&served, "served"));
    assert_eq!(
        number(&received, "received"),
        number(&published, "published")
    );
    survivors.share_only_their_own(1);
}

/// Reliable and best-effort links, checked by the numbers of the publications, while the Manager is
/// killed.
//= SM2-NOD-003, SM2-QOS-006 sys
#[test]
fn no_message_is_lost_when_the_manager_is_killed() {
    const BATCH: u64 = 500;
    let domain = TempDomain::new();
    let mut manager = domain.manager();
    let mut talker = Actor::start(&domain.socket(), "talker");
    let mut listeners = ["reliable", "best-effort"].map(|name| {
        let mut listener = Actor::start(&domain.socket(), name);
        let demand = if name == "reliable" { "reliable" } else { "" };
        listener.tell(&format!("sub t t depth=1024 {demand}"));
        listener
    });
    talker.tell("pub t t depth=1024 reliable_ms=60000");
    talker.tell("wait t 2");
    let mut impatient = impatient(&domain);
    for batch in 0..6 {
        let size = [8, 100, 5_000, 70_000][batch as usize % 4];
        talker.say(&format!("publish t {BATCH} {size}"));
        if batch == 2 {
            manager.kill();
        }
        for listener in &mut listeners {
            listener.say(&format!("take t {BATCH}"));
        }
        assert_eq!(talker.answer(), format!("ok took={} missed=0", 2 * BATCH));
        let (first, last) = (batch * BATCH + 1, (batch + 1) * BATCH);
        for listener in &listeners {
            let all = format!(
                "ok got={BATCH} bytes={} first={first} last={last} lost=0 damaged=0",
                BATCH * size
            );
            assert_eq!(listener.answer(), all, "{}", listener.name());
        }
    }
    let refused = impatient.ask("sub new new");
    assert!(refused.starts_with("error ManagerGone"), "{refused}");
}

/// A node that waits for a Manager only briefly. A machine that is slower than that makes it try again.
fn impatient(domain: &TempDomain) -> Actor {
    let options = ["--manager-timeout-ms", "200"];
    let mut started = None;
    eventually("a session", || {
        let actor = Actor::launch(&domain.socket(), "impatient", &options);
        let is_ready = actor.answer() == "ready";
        started = is_ready.then_some(actor);
        is_ready
    });
    started.expect("until now")
}

/// Each process that waits for a dying process is told of its death, so that no wait runs into a
/// deadline.
//= SM2-SRV-004, SM2-QOS-002, SM2-OPN-009 sys
#[test]
fn whoever_waits_for_the_dead_hears_of_it() {
    wait_for_the_dead(true);
}

/// Without a Manager, the link itself tells of the death.
//= SM2-NOD-003, SM2-SRV-004, SM2-OPN-009 sys
#[test]
fn whoever_waits_for_the_dead_hears_of_it_without_a_manager() {
    wait_for_the_dead(false);
}

fn wait_for_the_dead(managed: bool) {
    let domain = TempDomain::new();
    let mut manager = domain.manager();
    let mut talker = Actor::start(&domain.socket(), "talker");
    let mut victim = Actor::start(&domain.socket(), "victim");
    talker.tell("pub t t depth=2 reliable_ms=60000");
    talker.tell("client s s");
    victim.tell("sub t t depth=2 borrow=1 reliable");
    victim.tell("server s s");
    victim.tell("client back back");
    talker.tell("server back back");
    for (interface, peers) in [("t", 1), ("s", 1), ("back", 1)] {
        talker.tell(&format!("wait {interface} {peers}"));
    }
    // A call that the victim will not answer, and one whose answer the victim will not read.
    talker.tell("call s 100");
    victim.tell("call back 100");
    if !managed {
        manager.kill();
    }
    // More messages than there is room for, so the publisher waits.
    talker.say("publish t 50 5000");
    talker.say("reply s");
    thread::sleep(Duration::from_millis(50));
    victim.kill();
    let published = talker.answer();
    assert!(
        published.starts_with("ok") && published.ends_with("missed=0"),
        "{published}"
    );
    let replied = talker.answer();
    assert!(replied.starts_with("error ServerGone"), "{replied}");
    let refused = talker.ask("call s 100");
    assert!(refused.starts_with("error NoServer"), "{refused}");
    // The victim may have taken the request before it died.
    let link = talker.counted_with("t", "victim");
    assert!(!link.open && link.in_flight == 0, "{link:?}");
    assert_eq!(talker.tell("publish t 3 100"), "took=0 missed=0");
}

//= SM2-SRV-002 sys
#[test]
fn a_reply_to_a_dead_client_is_an_error_at_once() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let mut server = Actor::start(&domain.socket(), "server");
    server.tell("server s s");
    let mut client = Actor::start(&domain.socket(), "client");
    client.tell("client s s");
    client.tell("wait s 1");
    client.tell("call s 100");
    server.tell("accept s");
    client.kill();
    eventually("the end of the link", || {
        server.census().of_kind("socket") == 1
    });
    let replied = server.ask("answer s");
    assert!(replied.starts_with("error ClientGone"), "{replied}");
}
