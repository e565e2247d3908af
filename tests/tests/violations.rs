//! Every violation of SPEC, committed against real processes. Each gets its code, other processes
//! are not affected, and no resources are leaked.

// Shows MGR-STRICT, LNK-STRICT, MGR-NOISE, DAT-NOLEAK (test, full).

use std::{
    cell::{RefCell, RefMut},
    rc::Rc,
};

use sm2_io::SendError;
use sm2_proto::{Code, ViolationKind};
use sm2_tests::{
    actor::Actor,
    control::{self, Qos},
    domain::{ManagerProcess, TempDomain},
    eventually, link, pattern,
    raw::{RawLink, RawManager, RawNode},
    violations::{
        Row,
        link::{self as link_rows, LinkRow, LinkStage},
        manager,
        node::{self, NodeStage},
        spec,
    },
};

/// Two correct nodes of the domain, and the link between them.
struct Bystanders {
    one: RawNode,
    _other: RawNode,
    link: [RawLink; 2],
}

impl Bystanders {
    fn new(manager: &ManagerProcess) -> Self {
        let one = manager.node(manager::TAKEN);
        let other = manager.node("bystander-2");
        one.declare(1, &control::publisher("by", Qos::PLAIN));
        assert_eq!(other.declare(1, &control::subscriber("by", Qos::PLAIN)), 1);
        let link = [one.linked(), other.linked()];
        Self {
            one,
            _other: other,
            link,
        }
    }

    /// Asserts that the Manager answers them and has no other nodes, and that their link is
    /// unchanged.
    #[track_caller]
    fn are_untouched(&self) {
        assert_eq!(self.one.nodes(), [manager::TAKEN, "bystander-2"]);
        self.link[0].end.send(b"ping");
        assert_eq!(self.link[1].end.expect().bytes, b"ping");
        assert!(self.link[0].end.is_quiet(), "their link is quiet");
    }
}

/// Runs each row on a new connection. The Manager must send GOODBYE with the code, end the stream,
/// and send nothing else.
fn run_against(manager: &ManagerProcess, rows: &[Row<RawNode>]) {
    let bystanders = Bystanders::new(manager);
    // The Manager answers after it has finished all other work.
    bystanders.are_untouched();
    let baseline = manager.census_when_idle();
    for row in rows {
        let node = manager.connect();
        (row.commit)(&node);
        // Later frames are not answered (SM2-SES-005).
        let _: Result<(), SendError> = node.peer().try_send(&control::query(), &[]);
        assert_eq!(node.ended(), Some(row.violation.code()), "{row}");
        bystanders.are_untouched();
        baseline.restored(manager.pid());
        manager.log_says(row.clause);
    }
}

//= SM2-TRN-004, SM2-TRN-010, SM2-FRM-001, SM2-FRM-002 sys
//= SM2-FRM-003, SM2-NAM-001, SM2-SES-001, SM2-SES-002 sys
//= SM2-SES-005, SM2-SES-006, SM2-IFC-001, SM2-IFC-003 sys
//= SM2-LNK-003, SM2-COD-001 sys
#[test]
fn a_node_that_breaks_spec_is_gone_and_nobody_else() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    run_against(&manager, &manager::rows());
    run_against(&manager, &manager::precedence());
}

//= SM2-TRN-010 sys
#[test]
fn a_manager_without_descriptors_to_spare_hangs_up_on_whoever_sends_too_many() {
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--nofile", "40"]);
    run_against(&manager, &manager::starved_rows());
}

/// Whether the error of a declaration is awaited: each takes as long as another Manager may take to take over.
const DECLARATIONS_END: bool = cfg!(feature = "slow");

/// How long another Manager may take to take over.
const TAKE_OVER_MS: &str = "5000";

/// The node must send GOODBYE with the code and close the session. Its link continues.
fn run_against_node(rows: &[Row<NodeStage>], options: &[&str]) {
    for row in rows {
        let domain = TempDomain::new();
        let manager = RawManager::listen(&domain.socket());
        let options = [&["--manager-timeout-ms", TAKE_OVER_MS], options].concat();
        let actor = Actor::launch(&domain.socket(), "victim", &options);
        let session = manager.accept();
        // The node would reconnect, so its Manager is removed.
        drop(manager);
        assert_eq!(session.expect().bytes, control::hello("victim"));
        let stage = NodeStage::new(session, actor);
        (row.commit)(&stage);
        // The node's earlier frames, such as UNLINKED, arrive in between.
        let mut last = None;
        while let Some(frame) = stage.session.next_frame() {
            last = Some(frame.bytes);
        }
        let goodbye = control::goodbye(row.violation.code().0);
        assert_eq!(last, Some(goodbye), "{row}");
        let actor = stage.actor.borrow_mut();
        if stage.waiting.get() && (DECLARATIONS_END || !stage.declaring.get()) {
            let answer = actor.answer();
            for part in [format!("{:?}", row.violation), row.clause.to_owned()] {
                assert!(answer.contains(&part), "{row}: {answer}");
            }
        }
        links_go_on(&stage, actor, row);
    }
}

/// Asserts that the open link carries a message, and that no other link is left.
fn links_go_on(stage: &NodeStage, mut actor: RefMut<'_, Actor>, row: &Row<NodeStage>) {
    let links = stage.links.borrow();
    let open = usize::from(stage.linked.get());
    for link in &links[open..] {
        // Perhaps OPEN and CLOSE, and then the end of the stream.
        while link.next_frame().is_some() {}
    }
    if stage.linked.get() {
        let message = pattern::message(1, 100);
        links[0].send(link::inline(link::kind::DATA, 1, &message));
        let answer = actor.ask("take t 1");
        assert_eq!(
            answer, "ok got=1 bytes=100 first=1 last=1 lost=0 damaged=0",
            "{row}"
        );
        eventually("everything else to be closed", || {
            actor.census().of_kind("socket") == 1
        });
    }
}

//= SM2-NOD-001, SM2-NOD-002, SM2-NOD-003, SM2-LNK-004, SM2-IFC-002 sys
//= SM2-IFC-007, SM2-FRM-004 sys
#[test]
fn a_manager_that_breaks_spec_is_left_and_links_go_on() {
    run_against_node(&node::rows(), &[]);
    run_against_node(&node::starved_rows(), &["--nofile", "40"]);
}

/// The end must send CLOSE with the code. Only this link ends.
fn run_against_link(rows: Vec<LinkRow>, options: &[&str]) {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let options = [&["--ring-lane", "on"], options].concat();
    let victim = Actor::launch(&domain.socket(), "victim", &options);
    assert_eq!(victim.answer(), "ready");
    let victim = Rc::new(RefCell::new(victim));
    let mut friend = Actor::start(&domain.socket(), "friend");
    let tell = |command: &str| victim.borrow_mut().tell(command);
    tell("sub by by reliable");
    friend.tell("pub by by reliable_ms=60000");
    friend.tell("wait by 1");
    // From here on its segment is mapped.
    friend.tell("publish by 1 100");
    tell("take by 1");
    let raw = manager.node("observer");
    raw.nodes();
    let baseline = (
        manager.census_when_idle(),
        victim.borrow().census_when_idle(),
    );
    for LinkRow { real, row } in rows {
        tell(real.command());
        let raw = manager.node("raw");
        assert_eq!(raw.declare(1, &real.counterpart()), 1, "{row}");
        let stage = LinkStage {
            link: raw.linked(),
            real,
            victim: Rc::clone(&victim),
        };
        (row.commit)(&stage);
        let id = stage.link.id;
        assert_eq!(stage.link.closed(), Some(row.violation.code().0), "{row}");
        drop(stage);
        // Both sessions continue, and the offender is told that the link ended.
        assert_eq!(raw.unlinked(id), row.violation.code(), "{row}");
        raw.send(control::unlinked(1, id, 0));
        assert_eq!(
            raw.nodes(),
            ["victim", "friend", "observer", "raw"],
            "{row}"
        );
        friend.tell("publish by 1 100");
        let taken = tell("take by 1");
        assert!(
            taken.contains("got=1") && taken.contains("damaged=0"),
            "{row}: {taken}"
        );
        tell("close x");
        raw.close();
        baseline.0.restored(manager.pid());
        let pid = victim.borrow().pid();
        baseline.1.restored(pid);
    }
    friend.tell("publish by 4 100000");
    assert!(tell("take by 4").ends_with("lost=0 damaged=0"));
}

//= SM2-TRN-004, SM2-TRN-010, SM2-OPN-001, SM2-OPN-002, SM2-OPN-003 sys
//= SM2-OPN-004, SM2-OPN-007, SM2-OPN-008, SM2-OPN-009, SM2-LNK-009 sys
//= SM2-WIR-001, SM2-WIR-002, SM2-PAY-002, SM2-PAY-003, SM2-PAY-004 sys
//= SM2-PAY-001, SM2-PAY-005, SM2-PAY-008, SM2-SEG-001, SM2-SEG-002 sys
//= SM2-SEG-003, SM2-SEG-004, SM2-SEG-005, SM2-MSG-001, SM2-MSG-002 sys
//= SM2-MSG-003, SM2-MSG-004, SM2-SRV-001, SM2-SRV-002, SM2-SRV-003 sys
#[test]
fn a_peer_that_breaks_spec_loses_its_link_and_nothing_else_happens() {
    let mut rows = link_rows::rows();
    rows.extend(link_rows::precedence());
    run_against_link(rows, &[]);
}

//= SM2-TRN-010 sys
#[test]
fn a_node_without_descriptors_to_spare_closes_the_link_of_whoever_sends_too_many() {
    run_against_link(link_rows::starved_rows(), &["--nofile", "40"]);
}

/// Fails if a violation is reported under a clause that does not name it.
#[test]
fn every_violation_names_a_clause_that_speaks_of_it() {
    let named = spec::named_in_sources();
    assert!(named.len() > 100, "{} of them", named.len());
    for (kind, clause) in named {
        let mut kinds = ViolationKind::ALL.iter();
        let found = kinds.find(|it| format!("{it:?}") == kind);
        let found = *found.expect("the compiler knows it");
        assert!(
            spec::names(&clause, found),
            "{clause} does not speak of {kind}"
        );
    }
}

/// Fails if a violation is added, here or in SPEC, and no row commits it.
#[test]
fn every_violation_of_spec_has_its_rows() {
    let mut done: Vec<(ViolationKind, &str, String)> = Vec::new();
    let mut note = |violation, clause, row: String| done.push((violation, clause, row));
    for rows in [
        manager::rows(),
        manager::starved_rows(),
        manager::precedence(),
    ] {
        rows.iter()
            .for_each(|row| note(row.violation, row.clause, row.to_string()));
    }
    for rows in [node::rows(), node::starved_rows()] {
        rows.iter()
            .for_each(|row| note(row.violation, row.clause, row.to_string()));
    }
    for rows in [
        link_rows::rows(),
        link_rows::starved_rows(),
        link_rows::precedence(),
    ] {
        let rows = rows.iter().map(|LinkRow { row, .. }| row);
        rows.for_each(|row| note(row.violation, row.clause, row.to_string()));
    }
    let mut gaps = Vec::new();
    for (violation, clause, row) in &done {
        if !spec::names(clause, *violation) {
            gaps.push(format!("{clause} does not speak of it: {row}"));
        }
    }
    eprintln!("{} rows", done.len());
    let entries = spec::entries();
    for entry in &entries {
        let Some(violation) = spec::violation(entry) else {
            gaps.push(format!("sm2-proto has no violation {entry:?}"));
            continue;
        };
        for clause in &entry.clauses {
            if !done.iter().any(|(v, c, _)| *v == violation && c == clause) {
                gaps.push(format!("no row for {} by {clause}", entry.name));
            }
        }
    }
    for violation in ViolationKind::ALL {
        if !entries
            .iter()
            .any(|entry| Code(entry.code) == violation.code())
        {
            gaps.push(format!("SPEC section 10 has no {violation}"));
        }
        if !done.iter().any(|(v, _, _)| v == violation) {
            gaps.push(format!("no row for {violation}"));
        }
    }
    assert!(gaps.is_empty(), "{}", gaps.join("\n"));
}
