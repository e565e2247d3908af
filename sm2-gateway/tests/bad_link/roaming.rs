//! A robot's address changes while it is connected.

use std::process::Command;

use sm2_lossy_link::{DEVICE, Profile, Side, host_address};

use sm2_test_support::until;

use super::world::{self, World};
use crate::traffic::{Listener, Talker, assert_newer};

#[test]
fn a_gateway_whose_address_changes_is_heard_again() {
    let _alone = world::alone();
    let Some(link) = world::link(Profile::wifi()) else {
        return;
    };
    let world = World::new(link);
    let (robot, away) = (world.near.node("robot"), world.far.node("away"));
    let talker = Talker::start(&robot, "pose", 200, 30);
    let listener = Listener::newest(&away, "pose", &talker);
    until("heard", || listener.count() > 10);
    let address = world.peer_address();
    let old = host_address(Side::Near, false);
    // Only IPv4 is used, so that no route remains once the old address is removed.
    for change in [["del", &format!("{old}/24")], ["add", "10.77.1.9/24"]] {
        let ip = || {
            let arguments = [&["addr"], &change[..], &["dev", DEVICE]].concat();
            Command::new("ip").args(arguments).status()
        };
        let status = world.link.enter(Side::Near, ip).unwrap().unwrap();
        assert!(status.success(), "{change:?}");
    }
    let moved = talker.sent.lock().unwrap().len() as u64;
    until("heard again", || {
        let seen = listener.seen.lock().unwrap();
        let newer = seen.iter().filter(|it| it.number > Some(moved));
        newer.count() > 10
    });
    until("seen elsewhere", || {
        world.peer_address().is_some() && world.peer_address() != address
    });
    let how = match listener.ended() {
        0 => "its connection went on".to_owned(),
        ended => format!("it connected again, {ended} links ended"),
    };
    talker.stop();
    let seen = listener.stop();
    let last = seen.iter().rfind(|it| it.number <= Some(moved)).unwrap();
    let next = seen.iter().find(|it| it.number > Some(moved)).unwrap();
    world::say(&format!(
        "after the address changed {how}, and nothing came for {} ms",
        (next.at - last.at).as_millis()
    ));
    assert_newer("poses", &seen);
    world.stop();
}
