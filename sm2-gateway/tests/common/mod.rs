//! Domains with one gateway each.
#![allow(dead_code, unused_imports, reason = "each test uses its own part")]

#[cfg(feature = "program")]
mod process;

use std::{fmt::Write, fs, net::SocketAddr, path::PathBuf};

use sm2_gateway::{Config, Gateway, Report, keys};
use sm2_manager::{Background, Options};
use sm2_node::Node;
use sm2_proto::gateway::GatewayId;
use sm2_test_support::until;
use tokio::runtime::Runtime;

#[cfg(feature = "program")]
pub(crate) use self::process::Process;

/// A domain, and the files that its gateway needs.
pub(crate) struct Domain {
    manager: Option<Background>,
    pub(crate) name: &'static str,
    pub(crate) id: GatewayId,
    folder: tempfile::TempDir,
}

impl Domain {
    pub(crate) fn new(name: &'static str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let id = keys::generate(&folder.path().join("key")).unwrap().id();
        let socket = folder.path().join("sock");
        let manager = Background::start(&socket, Options::default()).unwrap();
        Self {
            manager: Some(manager),
            name,
            id,
            folder,
        }
    }

    pub(crate) fn node(&self, name: &str) -> Node {
        let socket = self.folder.path().join("sock");
        Node::builder(name).socket(socket).connect().unwrap()
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A configuration that trusts these peers and has these rules.
    pub(crate) fn config(&self, peers: &[(&Self, Option<SocketAddr>)], rules: &str) -> Config {
        self.config_at("127.0.0.1:0", peers, rules)
    }

    /// The same, for a gateway that listens at another address.
    pub(crate) fn config_at(
        &self,
        listen: &str,
        peers: &[(&Self, Option<SocketAddr>)],
        rules: &str,
    ) -> Config {
        let mut text = format!(
            "name = \"{}\"\nlisten = \"{listen}\"\nkey = \"key\"\nsocket = \"sock\"\n",
            self.name
        );
        for (peer, address) in peers {
            writeln!(
                text,
                "[[peer]]\nname = \"{}\"\nid = \"{}\"",
                peer.name, peer.id
            )
            .unwrap();
            if let Some(address) = address {
                writeln!(text, "addresses = [\"{address}\"]").unwrap();
            }
        }
        text.push_str(rules);
        let path = self.path("gateway.toml");
        fs::write(&path, text).unwrap();
        Config::load(&path).unwrap()
    }

    pub(crate) fn gateway(
        &self,
        runtime: &Runtime,
        peers: &[(&Self, Option<SocketAddr>)],
        rules: &str,
    ) -> Gateway {
        let config = self.config(peers, rules);
        runtime.block_on(Gateway::start(&config)).unwrap()
    }
}

/// A rule that lets every name pass in both directions.
pub(crate) const ALL: &str = "[[rule]]\naction = \"allow\"\nnames = \"**\"\n";

pub(crate) fn runtime() -> Runtime {
    let builder = tokio::runtime::Builder::new_multi_thread();
    { builder }.worker_threads(2).enable_all().build().unwrap()
}

/// A report with the parts of all connections. The gateway waits 250 ms for them, which a busy machine can exceed.
pub(crate) fn report(runtime: &Runtime, gateway: &Gateway) -> Report {
    let mut whole = None;
    until("a whole report", || {
        let report = runtime.block_on(gateway.report()).unwrap();
        let is_whole = report.peers.iter().all(|it| it.address.is_some());
        whole = is_whole.then_some(report);
        is_whole
    });
    whole.unwrap()
}
