//! How `sm2-bench` is linked.

/// At a fixed address: what the code of all peers together has of addresses (half a MiB) would else be
/// written anew, and so be private memory, in each process of each peer.
fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-link-arg-bins=-no-pie");
}
