//! `sm2 view`: the domain in a web browser.
//!
//! [`feed`] samples the domain on the main thread, which owns the node, and [`http`] serves the samples on a thread of
//! its own. They share a [`Site`](http::Site). [`access`] decides which requests are answered, [`assets`] has the files
//! of the page, [`unread`] closes connections whose client stops reading, and [`browser`] opens the page.

mod access;
mod assets;
mod browser;
mod events;
mod feed;
mod http;
mod schema;
mod unread;

use std::{
    net::{SocketAddr, TcpListener},
    sync::Arc,
};

use clap::Args;

use self::{
    access::Access,
    browser::Shortcut,
    feed::Feed,
    http::{Site, Timeouts},
};
use crate::{args::Domain, connect::CommandNode, ended::Ended, error::CliError, output::Output};

/// `sm2 view`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The address to listen on; port 0 chooses a free port
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:0")]
    listen: SocketAddr,
    /// Open the page in the default browser
    #[arg(long)]
    open: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
The first line of output is the URL of the page. It has a token: every request without it is refused,
since every user and every web page of this machine can reach a port of the loopback address.

The page shows nodes, topics and services, their links, rates, delays and losses, and the last events.
It reads counters that every node keeps. It does not subscribe, and publishers do not notice it. Counters
are read once a second, and only while a browser shows the page. The page changes nothing.

The page of another machine is reached through ssh: `ssh -L 8000:127.0.0.1:PORT robot`, and the URL with
port 8000.

Exit status: 0 ended by Ctrl-C or SIGTERM, 1 failed, 2 wrong usage.

Examples:
  sm2 view --open
  sm2 view --listen 127.0.0.1:8000
  sm2 view --domain arm --wait-manager 30s";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::Listen`] if the address cannot be used. Any error of [`CommandNode::open`] and of sampling.
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.domain, "view")?;
    let address = arguments.listen;
    let listen = |source| CliError::Listen { address, source };
    let listener = TcpListener::bind(address).map_err(listen)?;
    let address = listener.local_addr().map_err(listen)?;
    let access = Access::new(address).map_err(CliError::system("create a token"))?;
    let url = access.url();
    let mut feed = Feed::new(&command_node, arguments.domain.connect_timeout)?;
    let (site, requests) = Site::new(access).map_err(CliError::system("create a socket"))?;
    let server = http::start(listener, Arc::clone(&site), Timeouts::default()).map_err(listen)?;
    if !address.ip().is_loopback() {
        stderr_line!(
            "sm2: {address} can be reached from other machines, and the page is not encrypted: \
             everybody who can read the traffic can read the token"
        );
    }
    let mut out = Output::new();
    out.line(&url)?;
    out.flush()?;
    // It stays while the page is served.
    let _shortcut = arguments.open.then(|| {
        let failed =
            |error| stderr_line!("sm2: cannot open a browser ({error}): open the URL in one");
        Shortcut::open(&url).map_err(failed)
    });
    let ended = feed.run(&site, &requests);
    server.shutdown_background();
    ended
}
