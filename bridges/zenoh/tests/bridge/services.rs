//! Services between a domain and nodes of ROS 2, which `hiroz` provides.

use std::num::NonZeroUsize;
use std::thread;

use crate::common::{ALL, SEVEN, World, ros, wait_until};
use hiroz::Builder;
use hiroz::entity::EndpointKind;
use hiroz::msg::ZMessage;
use hiroz::qos::{QosHistory, QosProfile};
use hiroz_msgs::example_interfaces::srv::AddTwoInts;
use hiroz_msgs::example_interfaces::{AddTwoIntsRequest, AddTwoIntsResponse};
use sm2_node::{Client, Node, Server};
use sm2_proto::schema::Schema;
use sm2_proto::{Name, TypeId};
use sm2_ros_idl::{Kind, Set, TypeName};
use sm2_test_support::SOON;

/// The types of the requests and replies, which the node registers with their definitions.
fn register(node: &Node) -> [TypeId; 2] {
    let mut set = Set::default();
    let definitions = concat!(env!("CARGO_MANIFEST_DIR"), "/../../sm2-ros/definitions");
    set.add_folder(definitions.as_ref()).unwrap();
    let name = |name| TypeName::new("example_interfaces", Kind::Srv, name).unwrap();
    let text = "int64 a\nint64 b\n---\nint64 sum\n";
    set.add(&name("AddTwoInts"), text).unwrap();
    ["AddTwoInts_Request", "AddTwoInts_Response"].map(|part| {
        let text = set.schema_text(&name(part)).unwrap();
        let data = TypeId {
            name: Name::new(&name(part).to_string()).unwrap(),
            hash: Schema::parse(&text).unwrap().hash(),
        };
        node.register_schema(data.clone(), &text).unwrap();
        data
    })
}

fn server(node: &Node, service: &str) -> Server<[u8], [u8]> {
    let [request, reply] = register(node);
    let builder = node.server_builder::<[u8], [u8]>(service);
    builder.type_ids(request, reply).declare().unwrap()
}

fn client(node: &Node, service: &str) -> Client<[u8], [u8]> {
    let [request, reply] = register(node);
    let builder = node.client_builder::<[u8], [u8]>(service);
    builder.type_ids(request, reply).declare().unwrap()
}

const REQUEST: AddTwoIntsRequest = AddTwoIntsRequest { a: 1, b: 2 };

#[test]
fn nodes_of_ros_2_call_services_of_the_domain() {
    let world = World::new();
    let ros = ros(&world);
    let bridge = world.bridge(SEVEN, ALL);
    let server = server(&world.node("adder"), "add");
    let node = ros.create_node("caller").build().unwrap();
    let client = node.create_client::<AddTwoInts>("/add").build().unwrap();
    wait_until(|| ros.graph().count(EndpointKind::Service, "/add") == 1);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .build()
        .unwrap();
    let call = || runtime.block_on(client.call_with_timeout(&REQUEST, SOON));
    thread::scope(|scope| {
        scope.spawn(|| {
            let request = server.recv_timeout(SOON).unwrap().expect("a request");
            assert_eq!(*request, *REQUEST.serialize());
            let reply = AddTwoIntsResponse { sum: 3 };
            request.reply(&reply.serialize()).unwrap();
            let request = server.recv_timeout(SOON).unwrap().expect("a request");
            request.fail("it is tired").unwrap();
        });
        assert_eq!(call().unwrap().sum, 3);
        call().unwrap_err();
    });
    drop(server);
    wait_until(|| ros.graph().count(EndpointKind::Service, "/add") == 0);
    let counts = bridge.end();
    assert_eq!((counts.received, counts.sent), (2, 1), "{counts:?}");
}

#[test]
fn the_domain_calls_services_of_nodes_of_ros_2() {
    let world = World::new();
    let ros = ros(&world);
    let bridge = world.bridge(SEVEN, ALL);
    let client = client(&world.node("caller"), "add");
    let node = ros.create_node("adder").build().unwrap();
    let mut server = node.create_service::<AddTwoInts>("/add").build().unwrap();
    client.wait_for_servers_timeout(1, SOON).unwrap();
    wait_until(|| ros.graph().count(EndpointKind::Client, "/add") == 1);
    thread::scope(|scope| {
        scope.spawn(|| {
            let request = server.take_request().unwrap();
            let sum = request.message().a + request.message().b;
            request.reply_blocking(&AddTwoIntsResponse { sum }).unwrap();
        });
        let reply = client.call_timeout(&REQUEST.serialize(), SOON).unwrap();
        assert_eq!(*reply, *AddTwoIntsResponse { sum: 3 }.serialize());
    });
    drop(server);
    wait_until(|| !client.links().iter().any(|it| it.open));
    let counts = bridge.end();
    assert_eq!((counts.received, counts.sent), (1, 1), "{counts:?}");
}

/// More calls than the bridge holds at a time. The server answers the first ones only when all of these have come.
#[test]
fn calls_beyond_the_limit_wait() {
    const CALLS: NonZeroUsize = NonZeroUsize::new(20).unwrap();
    const HELD: usize = 16;
    let world = World::new();
    let ros = ros(&world);
    let bridge = world.bridge(SEVEN, ALL);
    let client = client(&world.node("caller"), "add");
    let node = ros.create_node("adder").build().unwrap();
    // By default, ten calls wait at a server of ROS 2.
    let qos = QosProfile {
        history: QosHistory::KeepLast(CALLS),
        ..QosProfile::default()
    };
    let server = node.create_service::<AddTwoInts>("/add").with_qos(qos);
    let mut server = server.build().unwrap();
    client.wait_for_servers_timeout(1, SOON).unwrap();
    let calls: Vec<_> = (0..CALLS.get())
        .map(|_| client.send_timeout(&REQUEST.serialize(), SOON).unwrap())
        .collect();
    let mut held = Vec::new();
    for number in 0..CALLS.get() {
        held.push(server.take_request().unwrap());
        if number + 1 >= HELD {
            for request in held.drain(..) {
                request
                    .reply_blocking(&AddTwoIntsResponse { sum: 3 })
                    .unwrap();
            }
        }
    }
    for call in calls {
        assert_eq!(
            *call.wait().unwrap(),
            *AddTwoIntsResponse { sum: 3 }.serialize()
        );
    }
    bridge.end();
}

/// The rules know services, and `out` offers those of the domain.
#[test]
fn denied_services_are_on_one_side_only() {
    let rules =
        "[[rule]]\naction = \"allow\"\nkind = \"service\"\nnames = \"add\"\ndirection = \"out\"\n";
    let world = World::new();
    let ros = ros(&world);
    let bridge = world.bridge(SEVEN, rules);
    let node = world.node("robot");
    let _servers = ["subtract", "add"].map(|it| server(&node, it));
    let client = client(&node, "multiply");
    let station = ros.create_node("station").build().unwrap();
    let _multiply = station
        .create_service::<AddTwoInts>("/multiply")
        .build()
        .unwrap();
    wait_until(|| ros.graph().count(EndpointKind::Service, "/add") == 1);
    assert_eq!(ros.graph().count(EndpointKind::Service, "/subtract"), 0);
    assert!(client.links().is_empty());
    bridge.end();
}
