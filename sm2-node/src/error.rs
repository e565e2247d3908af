//! The errors of this crate: one enum for each operation of a program.
//!
//! | what went wrong | how it is reported |
//! | --- | --- |
//! | the Manager or a peer broke the specification | its session or link ends, and a log names the clause |
//! | the program asked for something that it cannot have | a variant with the object, the rule and a remedy |
//! | the operating system refused | a variant with its error, which `os_error` returns |
//!
//! The log is an event of `tracing` with level `warn`.
//!
//! In all crates of SM2, the text of an error is one line that includes its cause, because programs print it by `{e}`,
//! and C and Python get nothing else. `Error::source` therefore does not return what the text shows: a printer of the
//! whole chain, such as `anyhow` or `eyre`, would print it twice. The cause is a public field of the variant.
//!
//! A field named `source` is written `r#source`. This is the same name, but thiserror does not return such a field.
//! `#[from]` makes a source as well, so a variant whose text shows its cause has no `#[from]`. `#[error(transparent)]`
//! forwards text and source, and needs nothing. `tests/tests/tidy/causes.rs` checks this.

mod control;
mod data;
mod os;

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
