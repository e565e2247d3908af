//! Linker options of `sm2-bench`.

/// Links at a fixed address. Otherwise each process would relocate half a MiB of addresses in the code of
/// all peers, which would be private memory of each process.
fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-link-arg-bins=-no-pie");
}
