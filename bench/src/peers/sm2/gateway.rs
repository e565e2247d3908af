//! One of two hosts: a Manager, and a gateway that is connected to the gateway of the other host.

use std::{
    fmt::Write,
    path::{Path, PathBuf},
};

use sm2_gateway::{Config, Gateway, keys};
use sm2_manager::{Background, Options};
use tokio::runtime::Runtime;

use crate::{
    job::{Domain, Side},
    link,
    peers::contract::PeerError,
};

/// The UDP port of both gateways; each host has its own network.
const PORT: u16 = 7_633;

/// Serves a host until the director ends. The far host starts first, and makes the keys of both.
pub(super) fn serve(
    domain: &Domain,
    side: Side,
    socket: &Path,
    ready: impl FnOnce(),
) -> Result<(), PeerError> {
    let manager = Background::start(socket, Options::default());
    let _manager = manager.map_err(PeerError::caused("run a Manager"))?;
    let config = configuration(domain, side, socket)?;
    let runtime = Runtime::new().map_err(PeerError::caused("start threads"))?;
    let gateway = runtime.block_on(Gateway::start(&config));
    let mut gateway = gateway.map_err(PeerError::caused("run a gateway"))?;
    ready();
    let ended = runtime.block_on(gateway.ended());
    Err(PeerError::new("run a gateway", ended.to_string()))
}

/// A configuration that names the other gateway as peer and allows all names in both directions.
fn configuration(domain: &Domain, side: Side, socket: &Path) -> Result<Config, PeerError> {
    let other = match side {
        Side::Near => Side::Far,
        Side::Far => Side::Near,
    };
    let mut text = format!(
        "name = \"{}\"\nlisten = \"0.0.0.0:{PORT}\"\nkey = \"{}\"\nsocket = \"{}\"\n\
         [[rule]]\naction = \"allow\"\nnames = \"**\"\n",
        side.as_str(),
        key(domain, side).display(),
        socket.display(),
    );
    if side == Side::Far {
        for side in [Side::Near, Side::Far] {
            keys::generate(&key(domain, side))
                .map_err(PeerError::caused("make a gateway's key"))?;
        }
    }
    let id = keys::load(&key(domain, other)).map_err(PeerError::caused("read a gateway's key"))?;
    let name = other.as_str();
    let _ = write!(text, "[[peer]]\nname = \"{name}\"\nid = \"{}\"\n", id.id());
    if other == Side::Far {
        let address = link::address(other);
        let _ = writeln!(text, "addresses = [\"{address}:{PORT}\"]");
    }
    let path = domain.dir.join(format!("{}.toml", side.as_str()));
    Config::parse(&path, &text).map_err(PeerError::caused("configure a gateway"))
}

fn key(domain: &Domain, side: Side) -> PathBuf {
    domain.dir.join(format!("{}.key", side.as_str()))
}
