//! A second domain behind a slow link, whose subscriber wants everything that the victim publishes.

use std::{
    fs,
    net::UdpSocket,
    path::{Path, PathBuf},
};

use sm2_gateway::keys;
use sm2_lossy_link::{LossyLink, Profile};
use sm2_tests::{
    domain::TempDomain,
    process::{Process, this_program},
};

use crate::{victims::TOPIC, world::manager};

/// Both gateways, the link and the far domain.
pub(crate) struct Remote {
    near: Process,
    _others: Vec<Process>,
    _link: LossyLink,
    _domain: TempDomain,
}

impl Remote {
    /// Connects the domain with this socket. Returns when the far subscriber has a message.
    pub(crate) fn start(socket: &Path) -> Self {
        let domain = TempDomain::new();
        let far_socket = domain.socket();
        let far_manager = manager(&far_socket, false);
        far_manager.stderr_says("serving");
        let mut link = LossyLink::relay(Profile {
            rate_bit: 1e6,
            loss_permille: 0,
            pauses: Vec::new(),
            ..Profile::wifi()
        });
        let free = UdpSocket::bind(link.listen()).and_then(|it| it.local_addr());
        let far_address = free.expect("a free port");
        let way = link.connect(far_address).expect("the link");
        let ids = ["near", "far"].map(|name| {
            let key = keys::generate(&domain.folder().join(format!("{name}.key")));
            key.expect("a key").id()
        });
        let near = config(domain.folder(), "near", socket, &link.listen().to_string());
        let near = near.peer("far", &ids[1].to_string(), &format!("\"{way}\""));
        let far = config(
            domain.folder(),
            "far",
            &far_socket,
            &far_address.to_string(),
        );
        let far = far.peer("near", &ids[0].to_string(), "");
        let mut subscriber = this_program("attack");
        subscriber.arg("--socket").arg(&far_socket);
        subscriber.args(["--role", "subscriber"]);
        let (far, near) = (far.start(), near.start());
        let subscriber = Process::start(subscriber);
        assert_eq!(subscriber.expect_line(), "ready");
        Self {
            near,
            _others: vec![far_manager, far, subscriber],
            _link: link,
            _domain: domain,
        }
    }
}

impl Remote {
    /// The gateway in the domain of the victims.
    pub(crate) const fn gateway(&mut self) -> &mut Process {
        &mut self.near
    }
}

/// The text of a gateway's configuration, and its file.
struct Config {
    path: PathBuf,
    text: String,
}

fn config(folder: &Path, name: &str, socket: &Path, listen: &str) -> Config {
    Config {
        path: folder.join(format!("{name}.toml")),
        text: format!(
            "name = \"{name}\"\nlisten = \"{listen}\"\nkey = \"{name}.key\"\nsocket = {socket:?}\n\
             [[rule]]\naction = \"allow\"\nnames = \"{TOPIC}\"\n"
        ),
    }
}

impl Config {
    fn peer(mut self, name: &str, id: &str, addresses: &str) -> Self {
        self.text +=
            &format!("[[peer]]\nname = \"{name}\"\nid = \"{id}\"\naddresses = [{addresses}]\n");
        self
    }

    fn start(self) -> Process {
        fs::write(&self.path, self.text).expect("a configuration");
        let mut command = this_program("gateway");
        command.arg("--config").arg(&self.path);
        Process::start(command)
    }
}
