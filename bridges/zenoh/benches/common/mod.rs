//! Processes that both benchmarks start.

use std::env;
use std::error::Error;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command};

use sm2_bridge_zenoh::{Bridge, Config};
use sm2_node::Shutdown;
use zenoh::{Session, Wait};

pub(crate) const MESSAGE_BYTES: usize = 1_000_000;

pub(crate) type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

/// Runs a bridge that carries all topics, between the domain of a folder and a router.
pub(crate) fn bridge(folder: &Path, endpoint: &str) -> Result<()> {
    let text = format!(
        "name = \"bench\"\nsocket = \"sock\"\nprefix = \"bench\"\n[zenoh]\nmode = \"client\"\n\
         connect = [\"{endpoint}\"]\n[[rule]]\naction = \"allow\"\nnames = \"**\"\n"
    );
    let config = Config::parse(&folder.join("bridge.toml"), &text)?;
    Ok(Bridge::start(&config)?.run(&Shutdown::new()?)?)
}

/// Opens a session. `role` is `listen` or `connect`.
pub(crate) fn session(mode: &str, role: &str, endpoint: &str) -> Result<Session> {
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", &format!("\"{mode}\""))?;
    config.insert_json5(&format!("{role}/endpoints"), &format!("[\"{endpoint}\"]"))?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    zenoh::open(config).wait()
}

/// An address that no program uses.
pub(crate) fn free_endpoint() -> Result<String> {
    let free = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
    Ok(format!("tcp/{free}"))
}

/// This program with other arguments. Ends with its owner.
pub(crate) struct Running(Child);

impl Running {
    pub(crate) fn start(role: &str, folder: &Path, endpoint: &str) -> Result<Self> {
        let mut program = Command::new(env::current_exe()?);
        Ok(Self(program.arg(role).arg(folder).arg(endpoint).spawn()?))
    }

    pub(crate) fn id(&self) -> u32 {
        self.0.id()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
