//! The example runs, and shows what it says.

#[allow(dead_code, reason = "its main prints")]
#[path = "../examples/in_memory.rs"]
mod in_memory;

//= SM2-LNK-004, SM2-NOD-003, SM2-RES-002 test
#[test]
fn messages_go_from_one_program_to_the_other_under_two_managers() {
    let mut lines = Vec::new();
    in_memory::World::new().run(&mut |line| lines.push(line));
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
