use sm2_manager::{Background, Options};
use sm2_proto::{TypeId, gateway::Subject};
use sm2_test_support::{SOON, until};

use super::*;
use crate::channel;

fn id(name: &str) -> TypeId {
    let name = Name::new(name).unwrap();
    TypeId { name, hash: 0 }
}

fn topic(name: &str) -> Subject {
    Subject::Topic {
        name: Name::new(name).unwrap(),
        data: id("bytes"),
        reliable: false,
        latched: 0,
    }
}

/// The hub asks again for the same subject when a peer wants another depth.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_subscribed_already_keeps_its_links() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("sock");
    let _manager = Background::start(&socket, Options::default()).unwrap();
    let location = DomainLocation::Socket(socket);
    let gateway = Name::new("robot").unwrap();
    let (hub, mut events) = channel::hub::channel();
    // The hub's side: takes everything.
    tokio::spawn(async move { while events.recv().await.is_some() {} });
    let mut local = Local::join(location.clone(), &gateway, 1_000, hub).unwrap();

    let node = location.connect("talker").unwrap();
    let publisher = |name: &str| {
        let builder = node.publisher_builder::<[u8]>(name).type_id(id("bytes"));
        builder.declare().unwrap()
    };
    let [first, later] = ["first", "later"].map(publisher);
    let server = node.server_builder::<[u8], [u8]>("service");
    let server = server.type_ids(id("request"), id("reply"));
    let server = server.declare().unwrap();
    let service = Subject::Service {
        name: Name::new("service").unwrap(),
        request: id("request"),
        reply: id("reply"),
    };
    let mut subscribe = |subject: Subject| {
        assert!(local.handle(LocalCommand::Subscribe { subject }).is_none());
    };
    subscribe(topic("first"));
    subscribe(service.clone());
    first.wait_for_subscribers_timeout(1, SOON).unwrap();
    until("a client", || server.links().iter().any(|it| it.open));
    let links = || (first.links()[0].id, server.links()[0].id);
    let before = links();

    subscribe(topic("first"));
    subscribe(service);
    // The Manager links interfaces in the order of their declarations.
    subscribe(topic("later"));
    later.wait_for_subscribers_timeout(1, SOON).unwrap();
    assert_eq!(links(), before);
    let ends = first.links().into_iter().chain(server.links());
    let ends: Vec<_> = ends.map(|it| (it.open, it.end)).collect();
    assert_eq!(ends, [(true, None), (true, None)]);
    assert!(!local.has_missing());
    // A message that crosses the end of its publisher is not lost: nobody wants it any more.
    let crossing = LocalCommand::Publish {
        subject: topic("gone"),
        origin: GatewayId([7; 32]),
        payload: bytes::Bytes::from_static(b"late"),
    };
    assert!(local.handle(crossing).is_none());
}
