//! Two gateways with a bad link between them.

use std::{
    fs,
    net::UdpSocket,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use sm2_gateway::keys;
use sm2_lossy_link::{LossyLink, Profile, Side};
use sm2_tests::process::Exit;
use tempfile::TempDir;

use crate::{
    child::{Broken, Child, Holds, command},
    report::Report,
};

/// A gateway that cannot start, since no Manager answers for example, starts again after this time.
const RESTART: Duration = Duration::from_millis(100);
/// The line of its log that tells a gateway which has started from one that could not.
const STARTED: &str = "gateway started";

/// The gateway of one domain.
pub(crate) struct Gateway {
    side: Side,
    config: PathBuf,
    pub(crate) child: Child,
    /// The resources that this process held at an earlier rest.
    pub(crate) held: Option<Holds>,
    /// When to start it again.
    restart_at: Option<Instant>,
}

/// Both gateways, and the link.
pub(crate) struct Gateways {
    _folder: TempDir,
    link: LossyLink,
    pub(crate) both: [Gateway; 2],
}

impl Gateways {
    /// Starts a gateway for each of the two domains with these sockets.
    pub(crate) fn start(sockets: [&Path; 2]) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (mut link, no_namespaces) = LossyLink::open(Profile::wifi());
        if let Some(reason) = no_namespaces {
            println!("the link is a relay on loopback: {reason}");
        }
        let ids = ["near", "far"].map(|name| {
            let key = keys::generate(&folder.path().join(format!("{name}.key")));
            key.expect("a key").id()
        });
        // A free port, which the far gateway keeps when it starts again.
        let listen = link.listen();
        let socket = link.enter(Side::Far, || UdpSocket::bind(listen));
        let socket = socket.expect("the far host").expect("a UDP socket");
        let far_address = socket.local_addr().expect("its address");
        drop(socket);
        let way = link.connect(far_address).expect("the link");
        let configs = [
            ("near", listen, "far", ids[1], format!("\"{way}\"")),
            ("far", far_address, "near", ids[0], String::new()),
        ];
        let both = configs
            .into_iter()
            .zip(sockets)
            .zip([Side::Near, Side::Far]);
        let both = both.map(|(((name, listen, peer, id, addresses), socket), side)| {
            let text = format!(
                "name = \"{name}\"\nlisten = \"{listen}\"\nkey = \"{name}.key\"\nsocket = {socket:?}\n\
                 [[peer]]\nname = \"{peer}\"\nid = \"{id}\"\naddresses = [{addresses}]\n\
                 [[rule]]\naction = \"allow\"\nnames = \"away/**\"\n"
            );
            let config = folder.path().join(format!("{name}.toml"));
            fs::write(&config, text).expect("a configuration");
            Gateway {
                child: start(&link, side, &config),
                side,
                config,
                held: None,
                restart_at: None,
            }
        });
        let both: Vec<Gateway> = both.collect();
        Self {
            both: both.try_into().ok().expect("two of them"),
            _folder: folder,
            link,
        }
    }

    /// Kills one of the two. Another process takes its place.
    pub(crate) fn kill(&mut self, index: usize, report: &mut Report) {
        report.kills += 1;
        let gateway = &mut self.both[index];
        gateway.child.process().kill();
        gateway.start_again(&self.link);
    }

    /// Starts a gateway again that could not start. A gateway that has started must not end by itself.
    pub(crate) fn look(&mut self, report: &mut Report) -> Result<(), Broken> {
        for gateway in &mut self.both {
            gateway.child.look(report);
            if let Some(at) = gateway.restart_at {
                if at <= Instant::now() {
                    gateway.start_again(&self.link);
                }
            } else if gateway.child.process().has_ended() {
                if !gateway.could_not_start() {
                    return gateway.child.must_live(report);
                }
                gateway.restart_at = Some(Instant::now() + RESTART);
            }
        }
        Ok(())
    }

    /// Ends both in order.
    pub(crate) fn end(self, report: &mut Report) {
        for mut gateway in self.both {
            gateway.child.end(report);
        }
    }
}

impl Gateway {
    fn start_again(&mut self, link: &LossyLink) {
        self.child = start(link, self.side, &self.config);
        self.held = None;
        self.restart_at = None;
    }

    /// Whether it ended with an error instead of starting.
    fn could_not_start(&mut self) -> bool {
        self.child.process().wait() == Exit::Status(1) && !self.child.log_has(STARTED)
    }
}

/// Starts a gateway in the network of its host.
fn start(link: &LossyLink, side: Side, config: &Path) -> Child {
    let name = match side {
        Side::Near => "the near gateway",
        Side::Far => "the far gateway",
    };
    let child = link.enter(side, || {
        let mut command = command("gateway");
        command.arg("--config").arg(config);
        Child::spawn(name, command)
    });
    child.expect("the network of a host")
}
