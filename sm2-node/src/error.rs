//! The errors of this crate: one enum for each operation of a program.
//!
//! | what went wrong | how it is reported |
//! | --- | --- |
//! | the Manager or a peer broke the specification | its session or link ends, and a log names the clause |
//! | the program asked for something that it cannot have | a variant with the object, the rule and a remedy |
//! | the operating system refused | a variant with its error as the `source` |
//!
//! The log is an event of `tracing` with level `warn`.

mod control;
mod data;

pub use control::{ConnectError, DeclareError, QueryError, ReloadError, SchemaError, WaitError};
pub use data::{CallError, PublishError, RecvError, ReplyError, StoreError};

use crate::driver::WaitFailure;

/// Implements the conversion for errors with the variants `Shutdown` and `Io`.
macro_rules! from_wait_failure {
    ($($error:ident)*) => {
        $(
            impl From<WaitFailure> for $error {
                fn from(failure: WaitFailure) -> Self {
                    match failure {
                        WaitFailure::Shutdown => Self::Shutdown,
                        WaitFailure::Io(error) => Self::Io(error),
                    }
                }
            }
        )*
    };
}

from_wait_failure!(PublishError QueryError RecvError WaitError);
