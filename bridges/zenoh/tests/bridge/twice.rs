//! Two bridges between the same domain and the same network.

use std::fs;

use crate::common::World;
use crate::program::Program;
use sm2_test_support::until;
use zenoh::Wait;

const RULES: &str = "[[rule]]\naction = \"allow\"\nnames = \"image\"\ndirection = \"out\"\n\
    [[rule]]\naction = \"allow\"\nnames = \"command\"\ndirection = \"in\"\n";

/// A bridge with a name and a prefix.
fn bridge(world: &World, name: &str, prefix: &str) -> Program {
    let head = format!("name = \"{name}\"\nprefix = \"{prefix}\"");
    let written = world.write_config(&head, &world.endpoint, RULES);
    let file = world.path(&format!("{name}.toml"));
    fs::rename(written, &file).unwrap();
    Program::start(&file, &[])
}

#[test]
fn a_topic_that_two_bridges_carry_is_reported() {
    let world = World::new();
    for prefix in ["fleet", "other"] {
        let subscriber = world.network.declare_subscriber(format!("{prefix}/image"));
        subscriber.callback(drop).background().wait().unwrap();
    }
    let camera = world.node("camera").publisher::<[u8]>("image").unwrap();
    let links = || camera.links().iter().filter(|it| it.open).count();
    // It carries the topic to another network, and is reported by nobody. It would be the first one.
    let _aside = bridge(&world, "aside", "other");
    let first = bridge(&world, "first", "fleet");
    until("both carry the topic", || links() == 2);
    let second = bridge(&world, "second", "fleet");
    let warning =
        "another bridge of the domain carries this topic, too: each message arrives twice";
    for (bridge, other) in [(&second, "first"), (&first, "second")] {
        let line = bridge.wait_for(warning);
        let fields = format!("bridge={other} topic=image direction=\"out\"");
        assert!(line.contains("WARN") && line.contains(&fields), "{line}");
    }

    until("both bring the topic", || {
        world.network.put("fleet/command", "go").wait().unwrap();
        first.count("received") > 0 && second.count("received") > 0
    });
    let line = second.wait_for(warning);
    let fields = "bridge=first topic=command direction=\"in\"";
    assert!(line.contains(fields), "{line}");
}
