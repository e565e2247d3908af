//! The example `in_memory` plays the session that SPEC shows in Annex C.

#[allow(dead_code, reason = "its main prints")]
#[path = "../examples/in_memory.rs"]
mod in_memory;

//= SM2-LNK-009, SM2-NOD-003, SM2-RES-002 test
#[test]
fn messages_go_from_one_program_to_the_other_under_two_managers() {
    let mut lines = Vec::new();
    in_memory::World::new().run(&mut |step| lines.push(step.to_string()));
    let steps = [
        "lidar -> Manager: Hello",
        "Manager -> planner: Welcome",
        "planner -> Manager: Declare",
        "Manager -> planner: Link",
        "planner -> lidar: Open",
        "lidar -> planner: Message",
        "planner -> lidar: Release",
        "The Manager dies",
        "lidar -> Manager: Hello",
        "lidar -> Manager: Declare",
        "planner -> Manager: Declare",
        "lidar -> Manager: Claim {",
        "lidar -> Manager: Claimed",
        "lidar -> planner: Message",
        "planner -> lidar: Release",
        "lidar -> Manager: Withdraw",
        "Manager -> lidar: Withdrawn",
        "planner -> Manager: Unlinked",
        "lidar -> Manager: Goodbye",
    ];
    let mut rest = lines.iter();
    for step in steps {
        assert!(
            rest.any(|line| line.starts_with(step)),
            "{step}: {lines:#?}"
        );
    }
    assert!(lines.last().is_some_and(|line| line.ends_with("0 links")));
}

/// Annex C lists the datagrams of the example: a line with the route and the name of the frame, then a line for each
/// field: two blanks, the bytes, a bar, and the field. `as above` stands for the fields of the last frame with this
/// route and name.
#[test]
fn annex_c_of_spec_has_the_bytes_of_this_session() {
    let spec = include_str!("../../SPEC.md");
    let (_, annex) = spec.split_once("\n## Annex C.").expect("an annex");
    let annex = annex.split_once("\n## ").map_or(annex, |(annex, _)| annex);
    let mut written: Vec<(String, Vec<u8>)> = Vec::new();
    let mut names = Vec::new();
    for line in annex.lines() {
        if let Some((hex, _)) = line.strip_prefix("  ").and_then(|it| it.split_once(" | ")) {
            let bytes = hex
                .split_whitespace()
                .map(|it| u8::from_str_radix(it, 16).expect("two hexadecimal digits"));
            written
                .last_mut()
                .expect("a route stands above")
                .1
                .extend(bytes);
        } else if let Some((route, name)) =
            line.split_once(": ").filter(|(it, _)| it.contains(" -> "))
        {
            let again = name.strip_suffix(", as above");
            let name = (route, again.unwrap_or(name));
            let before = names.iter().rposition(|it| *it == name);
            let bytes = again.map(|_| written[before.expect("a frame above")].1.clone());
            names.push(name);
            written.push((route.to_owned(), bytes.unwrap_or_default()));
        }
    }
    let mut played = Vec::new();
    in_memory::World::new().run(&mut |step| {
        if !step.bytes.is_empty() {
            played.push((step.route, step.bytes));
        }
    });
    assert_eq!(written, played);
}
