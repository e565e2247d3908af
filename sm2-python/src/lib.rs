//! The native part of the Python package `sm2`: nodes, publishers, subscribers and services of SM2 as Python objects.
//!
//! The Python files in `python/sm2` build on this module. They know message types, numpy and asyncio; this module knows
//! only bytes. Four rules hold here, so that no Python program can crash its process:
//!
//! | rule | kept by |
//! | --- | --- |
//! | A view of memory owns a reference to the object that keeps the memory. | `buffers` |
//! | A forked child uses and drops no handle of its parent. | `handles::Owned` |
//! | A thread that waits or copies has released the GIL. | `detached` |
//! | No lock of SM2 is held while a thread waits for the GIL: log records are queued. | `logging` |
#![deny(unsafe_code)]

#[allow(
    unsafe_code,
    reason = "numpy's interface for C: functions and raw pointers"
)]
mod array;
#[allow(
    unsafe_code,
    reason = "the buffer protocol: raw pointers to and from Python"
)]
mod buffers;
mod client;
mod detached;
mod errors;
mod handles;
#[allow(unsafe_code, reason = "the buffer protocol: raw pointers from Python")]
mod input;
mod interface;
mod loan;
mod logging;
#[allow(unsafe_code, reason = "the number of references to a Python object")]
mod memory;
mod message_type;
mod node;
mod options;
mod publisher;
mod ros;
mod sample;
mod server;
mod subscriber;
mod timer;
mod wait;

/// The module `sm2._native`.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::client::{Call, Client};
    #[pymodule_export]
    use crate::errors::{
        BorrowLimitError, CallError, ClosedError, ConnectError, DeclareError, Error, ForkError,
        LoanError, PublishError, QueryError, RecvError, ReplyError, SchemaError, TypeMismatchError,
        WaitError,
    };
    #[pymodule_export]
    use crate::loan::Loan;
    #[pymodule_export]
    use crate::node::Node;
    #[pymodule_export]
    use crate::publisher::{Published, Publisher};
    #[pymodule_export]
    use crate::ros::{RosType, RosView};
    #[pymodule_export]
    use crate::sample::Sample;
    #[pymodule_export]
    use crate::server::{Request, Server};
    #[pymodule_export]
    use crate::subscriber::Subscriber;
    #[pymodule_export]
    use crate::timer::{Tick, Timer};

    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(_module: &Bound<'_, PyModule>) -> PyResult<()> {
        crate::logging::install();
        Ok(())
    }
}
