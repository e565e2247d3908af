//! `sm2 gateway run`.

use std::path::PathBuf;

use clap::Args;
use tokio::signal::unix::{SignalKind, signal};

use super::ProgramError;
use crate::{Config, Gateway};

/// `sm2 gateway run`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The configuration
    #[arg(value_name = "FILE")]
    config: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = Config::load(&arguments.config)?;
    let runtime = tokio::runtime::Builder::new_multi_thread();
    let runtime = { runtime }
        // One for what waits for the Manager, one for the rest: a gateway is no user of all cores.
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(ProgramError::system("start threads"))?;
    let result = runtime.block_on(serve(&config));
    runtime.shutdown_background();
    result
}

async fn serve(config: &Config) -> Result<(), ProgramError> {
    let catch = |kind| signal(kind).map_err(ProgramError::system("catch signals"));
    let mut hang_up = catch(SignalKind::hangup())?;
    let mut interrupt = catch(SignalKind::interrupt())?;
    let mut terminate = catch(SignalKind::terminate())?;
    let mut gateway = Gateway::start(config).await?;
    if config.policy.rules.0.is_empty() {
        tracing::warn!("there is no [[rule]]: nothing goes anywhere");
    }
    loop {
        tokio::select! {
            _ = hang_up.recv() => match Config::load(&config.path) {
                Ok(new) => {
                    gateway.reload(&new).await;
                    tracing::info!(file = %config.path.display(), "rules and peers are those of the file again");
                }
                Err(error) => tracing::error!(%error, "the file was not taken: all goes on as before"),
            },
            _ = interrupt.recv() => break,
            _ = terminate.recv() => break,
            error = gateway.ended() => return Err(error.into()),
        }
    }
    gateway.stop().await;
    Ok(())
}
