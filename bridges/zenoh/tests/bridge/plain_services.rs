//! Services in mode plain: between two domains, and for other programs of the network.

use std::thread;

use crate::common::{ALL, Running, World, wait_until};
use sm2_node::{Node, Server};
use sm2_proto::{Name, TypeId};
use sm2_test_support::{SOON, until};
use zenoh::Wait;
use zenoh::bytes::Encoding;

fn head(name: &str) -> String {
    format!("name = \"{name}\"\nprefix = \"fleet\"")
}

fn types() -> [TypeId; 2] {
    ["arm/Request", "arm/Reply"].map(|name| TypeId {
        name: Name::new(name).unwrap(),
        hash: 7,
    })
}

fn server(node: &Node, service: &str) -> Server<[u8], [u8]> {
    let [request, reply] = types();
    let builder = node.server_builder::<[u8], [u8]>(service);
    builder.type_ids(request, reply).declare().unwrap()
}

/// A robot and a site, whose bridges are in one network.
fn fleet(rules: &str) -> (World, World, [Running; 2]) {
    let (robot, site) = (World::new(), World::new());
    let bridges = [
        robot.bridge(&head("robot"), rules),
        site.bridge_to(&robot.endpoint, &head("site"), ALL),
    ];
    (robot, site, bridges)
}

#[test]
fn a_domain_calls_the_services_of_another_one() {
    let (robot, site, bridges) = fleet(ALL);
    let server = server(&robot.node("arm"), "arm/reset");
    let [request, reply] = types();
    let station = site.node("station");
    let client = station.client_builder::<[u8], [u8]>("arm/reset");
    let client = client.type_ids(request, reply).declare().unwrap();
    client.wait_for_servers_timeout(1, SOON).unwrap();
    thread::scope(|scope| {
        scope.spawn(|| {
            let request = server.recv_timeout(SOON).unwrap().expect("a request");
            assert_eq!(*request, *b"now");
            request.reply(b"done").unwrap();
            let request = server.recv_timeout(SOON).unwrap().expect("a request");
            request.fail("it is tired").unwrap();
        });
        assert_eq!(*client.call_timeout(b"now", SOON).unwrap(), *b"done");
        client.call_timeout(b"again", SOON).unwrap_err();
    });
    drop(server);
    wait_until(|| !client.links().iter().any(|it| it.open));
    let [robot, site] = bridges.map(Running::end);
    assert_eq!((robot.received, robot.sent), (2, 1), "{robot}");
    assert_eq!((site.received, site.sent), (1, 2), "{site}");
}

#[test]
fn programs_of_the_network_call_services_with_and_without_types() {
    let world = World::new();
    let bridge = world.bridge(&head("robot"), ALL);
    let server = server(&world.node("arm"), "arm/reset");
    let tokens = world.network.liveliness();
    until("the service is there", || {
        let tokens = tokens.get("fleet/@service/robot/**").wait().unwrap();
        tokens.into_iter().any(|it| it.result().is_ok())
    });
    let call = |encoding: Encoding| {
        let call = world.network.get("fleet/arm/reset").payload("now");
        let replies = call.encoding(encoding).timeout(SOON).wait().unwrap();
        let reply = replies.recv_timeout(SOON).unwrap().expect("a reply");
        let result = reply.into_result();
        result
            .map(|it| it.payload().to_bytes().into_owned())
            .map_err(|it| it.payload().to_bytes().into_owned())
    };
    let schema =
        |hash: u64| Encoding::ZENOH_BYTES.with_schema(format!("sm2:arm/Request:{hash:016x}"));
    thread::scope(|scope| {
        scope.spawn(|| {
            for _ in 0..2 {
                let request = server.recv_timeout(SOON).unwrap().expect("a request");
                assert_eq!(*request, *b"now");
                request.reply(b"done").unwrap();
            }
        });
        assert_eq!(call(Encoding::ZENOH_BYTES), Ok(b"done".to_vec()));
        let wrong = call(schema(8)).unwrap_err();
        assert_eq!(wrong, b"the service has other types");
        assert_eq!(call(schema(7)), Ok(b"done".to_vec()));
    });
    bridge.end();
}

#[test]
fn denied_services_are_not_in_the_network() {
    let rules = "[[rule]]\naction = \"deny\"\nkind = \"service\"\nnames = \"arm/stop\"\n";
    let (robot, site, bridges) = fleet(&format!("{rules}{ALL}"));
    let arm = robot.node("arm");
    let _servers = ["arm/stop", "arm/reset"].map(|it| server(&arm, it));
    let station = site.node("station");
    let clients = ["arm/stop", "arm/reset"].map(|it| {
        let [request, reply] = types();
        let client = station.client_builder::<[u8], [u8]>(it);
        client.type_ids(request, reply).declare().unwrap()
    });
    // The bridge offers both at the same time.
    clients[1].wait_for_servers_timeout(1, SOON).unwrap();
    assert!(clients[0].links().is_empty());
    for bridge in bridges {
        bridge.end();
    }
}
