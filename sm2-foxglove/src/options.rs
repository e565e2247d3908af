use std::net::SocketAddr;

use sm2_proto::gateway::Pattern;

/// The settings of a server.
#[derive(Clone, Debug)]
pub struct Options {
    /// The address to listen on. Port 0 chooses a free port.
    pub listen: SocketAddr,
    /// The topics that viewers see; all of them if there is no pattern.
    pub topics: Vec<Pattern>,
    /// Origins of pages that may connect, such as `https://studio.example`, besides those of this machine and
    /// Foxglove's own.
    pub allow_origins: Vec<String>,
    /// Whether viewers may publish.
    pub allow_publish: bool,
    /// The messages that may wait for one viewer, in bytes, that in flight included.
    pub viewer_budget_bytes: usize,
}

impl Options {
    /// The budget of a viewer if no other one is set, in bytes.
    pub const VIEWER_BUDGET_BYTES: usize = 64 * 1024 * 1024;
}

impl Default for Options {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            topics: Vec::new(),
            allow_origins: Vec::new(),
            allow_publish: false,
            viewer_budget_bytes: Self::VIEWER_BUDGET_BYTES,
        }
    }
}
