//! A process of the demo.

use nix::sys::{prctl, signal::Signal};

use super::{
    command_line::{ProcessArguments, Role},
    part::{self, ProcessEvent},
    publisher, subscriber,
};
use crate::error::DemoError;

/// Runs one process of the demo. A failure is reported to the demo on standard output.
///
/// # Errors
///
/// [`DemoError::Output`].
pub fn run(arguments: &ProcessArguments) -> Result<(), DemoError> {
    // If this fails, the end of standard input ends this process, only later.
    let _ = prctl::set_pdeathsig(Signal::SIGKILL);
    let result = match arguments.role {
        Role::Publisher => publisher::run(arguments),
        Role::Subscriber => subscriber::run(arguments),
    };
    let reported = result.or_else(|error| {
        part::send_event(&ProcessEvent::Failed {
            reason: error.to_string(),
        })
    });
    Ok(reported?)
}
