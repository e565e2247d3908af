//! A topic from one domain to another, while a call of their gateways fails.

use std::{fs, mem, time::Duration};

use sm2_gateway::{Config, Gateway, keys};
use sm2_io::fault::Injector;
use sm2_manager::{Background, Options};
use sm2_node::Node;
use sm2_proto::gateway::GatewayId;
use tokio::runtime::{Builder, Runtime};

use super::{
    scenarios::LENGTHS,
    topic::Topic,
    world::{World, patient},
};

/// Two gateways start, connect and carry messages.
pub(crate) fn gateways(world: &mut World) {
    let runtime = runtime(world.injector());
    let far_socket = world.path("far.sock");
    let far_domain = Background::start(&far_socket, Options::default()).unwrap();
    let [near, far] = ["near", "far"].map(|name| {
        let key = keys::generate(&world.path(&format!("{name}.key"))).unwrap();
        (name, key.id())
    });
    let far_gateway = start(&runtime, &config(world, far.0, "far.sock", near, ""));
    let addresses = format!("addresses = [\"{}\"]\n", far_gateway.address());
    let near_gateway = start(
        &runtime,
        &config(world, near.0, "test.sock", far, &addresses),
    );
    let talker = world.node("talker", true);
    let listener = patient("a listener", || {
        Node::builder("listener").socket(&far_socket).connect()
    });
    let publisher = patient("a publisher", || talker.publisher("topic"));
    let subscriber = patient("a subscriber", || listener.subscriber("topic"));
    let mut topic = Topic::new(publisher, subscriber).linked().heard(world);
    for len in LENGTHS {
        topic.carry(world, len);
    }
    let count = |gateway: &Gateway| -> u64 {
        let report = runtime
            .block_on(gateway.report())
            .expect("a running gateway");
        let of_peers = report.peers.iter().map(|it| it.messages);
        of_peers
            .map(|it| it.superseded + it.expired + it.withdrawn + it.refused + it.lost + it.skipped)
            .sum()
    };
    // A message that the far gateway has published is one of its domain, which the other scenarios account for: the
    // link may have ended.
    let in_far_domain = published_by(&listener, "remote/near").saturating_sub(topic.received());
    let in_gateways = count(&near_gateway) + count(&far_gateway);
    topic.adds_up_beside(in_gateways + in_far_domain);
    runtime.block_on(async { tokio::join!(near_gateway.stop(), far_gateway.stop()) });
    runtime.shutdown_timeout(Duration::from_secs(5));
    drop(far_domain);
}

/// How many messages a node has published, as its counters say. Zero if a fault left it without counters.
fn published_by(asker: &Node, name: &str) -> u64 {
    let domain = patient("a snapshot", || asker.snapshot());
    let node = domain.nodes().find(|it| it.name.as_str() == name);
    let node = node.expect("a node").node;
    let Some(counters) = patient("counters", || asker.inspect(node)) else {
        return 0;
    };
    let entries = counters.entries().filter_map(|(_, entry)| entry.ok());
    let interfaces = entries.filter(|it| it.link.is_none());
    interfaces.map(|it| it.messages).sum()
}

/// Opens the sockets that tokio needs to pass signals on: they belong to the process, and stay.
pub(crate) fn prepare() {
    drop(runtime(Injector::counting()));
}

/// A runtime whose threads have the fault of the scenario.
fn runtime(faults: Injector) -> Runtime {
    let builder = Builder::new_multi_thread();
    { builder }
        .worker_threads(2)
        .enable_all()
        // For the life of the thread.
        .on_thread_start(move || mem::forget(faults.install()))
        .build()
        .unwrap()
}

/// Starts a gateway on the threads of the runtime, again and again until it succeeds.
fn start(runtime: &Runtime, config: &Config) -> Gateway {
    patient("a gateway", || {
        let config = config.clone();
        let starting = runtime.spawn(async move { Gateway::start(&config).await });
        runtime.block_on(starting).expect("no panic")
    })
}

fn config(
    world: &World,
    name: &str,
    socket: &str,
    (peer, id): (&str, GatewayId),
    addresses: &str,
) -> Config {
    let text = format!(
        "name = \"{name}\"\nlisten = \"127.0.0.1:0\"\nkey = \"{name}.key\"\nsocket = \"{socket}\"\n\
         [[peer]]\nname = \"{peer}\"\nid = \"{id}\"\n{addresses}\
         [[rule]]\naction = \"allow\"\nnames = \"**\"\n"
    );
    let path = world.path(&format!("{name}.toml"));
    fs::write(&path, text).unwrap();
    Config::load(&path).unwrap()
}
