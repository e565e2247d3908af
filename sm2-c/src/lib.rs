//! The C ABI of SM2's nodes: `include/sm2.h` is made of this crate's documentation.
//!
//! Each entry point has the same shape: [`guard`](status::guard) runs its body, which checks the arguments
//! ([`arguments`]), calls `sm2-node`, and stores the result. Handles are boxes. The header states what a C program must
//! keep to; the `SAFETY` texts refer to it.

mod aligned;
mod arguments;
mod client;
mod errors;
mod loan;
mod log;
mod node;
mod publisher;
mod qos;
mod report;
mod ros;
mod sample;
mod server;
mod shutdown;
mod status;
mod subscriber;
#[cfg(test)]
mod tests;
mod types;
mod wait_set;

use std::ffi::c_char;

// Several threads may use each of these handles at the same time, and free it in any thread, as the header says.
const _: fn() = || {
    fn can_be_shared<T: Send + Sync>() {}
    can_be_shared::<node::Node>();
    can_be_shared::<publisher::Publisher>();
    can_be_shared::<subscriber::Subscriber>();
    can_be_shared::<server::Server>();
    can_be_shared::<client::Client>();
    can_be_shared::<shutdown::Shutdown>();
};

/// The version of the ABI that this header describes. A program that was built with it runs with every library of the
/// same version.
pub const ABI_VERSION: u32 = 1;

/// Returns the version of the library's ABI, to be compared with `SM2_ABI_VERSION`.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_abi_version() -> u32 {
    ABI_VERSION
}

/// Returns the version of the library, such as `0.1.0`. The text is valid forever.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_version() -> *const c_char {
    const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "\0");
    VERSION.as_ptr().cast()
}
