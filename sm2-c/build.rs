//! Gives the shared library the name that programs look for when they start: it changes with the version of the ABI.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libsm2.so.0");
}
