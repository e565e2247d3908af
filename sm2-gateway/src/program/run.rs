#[cfg(feature = "metrics")]
use std::net::SocketAddr;
use std::{io, panic, path::PathBuf, sync::mpsc};

use clap::Args;
use nix::{errno::Errno, sys::prctl::set_no_new_privs};
#[cfg(feature = "metrics")]
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::signal::unix::{SignalKind, signal};

use super::error::ProgramError;
use crate::{Config, Gateway};

/// `sm2 gateway run`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The configuration
    #[arg(value_name = "FILE")]
    config: PathBuf,
    /// Log what the rules and peers of this configuration would change, without effect
    #[arg(long, value_name = "FILE")]
    shadow: Option<PathBuf>,
    /// Serve metrics for Prometheus at http://ADDRESS/metrics. Use a loopback address: every client may read them
    #[cfg(feature = "metrics")]
    #[arg(long, value_name = "ADDRESS")]
    metrics: Option<SocketAddr>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    // A gateway never executes a program. Its threads inherit this.
    if let Err(error) = set_no_new_privs() {
        tracing::warn!(%error, "this process can still gain rights by executing programs");
    }
    sm2_io::raise_descriptor_limit();
    let config = Config::load(&arguments.config)?;
    let shadow = arguments.shadow.as_deref();
    let shadow = shadow.map(Config::load).transpose()?;
    let runtime = runtime().map_err(ProgramError::system("start threads"))?;
    let result = runtime.block_on(serve(&config, shadow, arguments));
    runtime.shutdown_background();
    result
}

/// Starts the threads for the tasks of the gateway.
///
/// If the system cannot start one of them, tokio panics, and then waits for ever for those that it has started. So
/// another thread builds the runtime, and its panic is reported before it waits. No other code of this program runs
/// yet that could panic.
fn runtime() -> io::Result<Runtime> {
    let (sender, built) = mpsc::channel();
    let panicked = sender.clone();
    let hook = panic::take_hook();
    panic::set_hook(Box::new(move |_| {
        let _ = panicked.send(Err(Errno::EAGAIN.into()));
    }));
    let started = sm2_io::spawn_without_signals("start".to_owned(), move || {
        let builder = tokio::runtime::Builder::new_multi_thread();
        let _ = sender.send({ builder }.worker_threads(2).enable_all().build());
    });
    let result = started.and_then(|_| built.recv().map_err(io::Error::other)?);
    panic::set_hook(hook);
    result
}

async fn serve(
    config: &Config,
    shadow: Option<Config>,
    arguments: &Arguments,
) -> Result<(), ProgramError> {
    let catch = |kind| signal(kind).map_err(ProgramError::system("catch signals"));
    let mut hang_up = catch(SignalKind::hangup())?;
    let mut interrupt = catch(SignalKind::interrupt())?;
    let mut terminate = catch(SignalKind::terminate())?;
    // Binds before anything starts, so that an address in use has no side effects.
    #[cfg(feature = "metrics")]
    let metrics = metrics(arguments).await?;
    let mut gateway = Gateway::start(config).await?;
    #[cfg(feature = "metrics")]
    if let Some(listener) = metrics {
        gateway.serve_metrics(listener);
    }
    if let Some(shadow) = shadow {
        gateway.set_shadow(shadow);
    }
    if config.policy.rules.0.is_empty() {
        tracing::warn!("there is no [[rule]]: the gateway carries nothing");
    }
    loop {
        tokio::select! {
            _ = hang_up.recv() => reload(&gateway, config, arguments).await,
            _ = interrupt.recv() => break,
            _ = terminate.recv() => break,
            error = gateway.ended() => return Err(error.into()),
        }
    }
    gateway.stop().await;
    Ok(())
}

/// Reads both files again, independently of each other. A bad file changes nothing.
async fn reload(gateway: &Gateway, started: &Config, arguments: &Arguments) {
    match Config::load(&arguments.config) {
        Ok(new) => {
            gateway.reload(&new).await;
            let file = new.path.display();
            tracing::info!(%file, "reloaded rules and peers");
            for key in started.fixed_keys(&new) {
                tracing::warn!(%file, "`{key}` has changed: restart to use it");
            }
        }
        Err(error) => {
            tracing::error!(%error, "cannot reload the configuration: the rules and peers stay as they were")
        }
    }
    match arguments.shadow.as_deref().map(Config::load) {
        Some(Ok(new)) => gateway.set_shadow(new),
        Some(Err(error)) => {
            tracing::error!(%error, "cannot reload the shadow configuration: it stays as it was")
        }
        None => {}
    }
}

#[cfg(feature = "metrics")]
async fn metrics(arguments: &Arguments) -> Result<Option<TcpListener>, ProgramError> {
    let Some(address) = arguments.metrics else {
        return Ok(None);
    };
    let listener = TcpListener::bind(address).await;
    let listener = listener.map_err(|source| ProgramError::Metrics { address, source })?;
    let address = listener.local_addr().unwrap_or(address);
    tracing::info!("serving metrics at http://{address}/metrics");
    Ok(Some(listener))
}
