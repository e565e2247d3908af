//! Gives the shared library the name by which programs find it when they start: it changes with the version of the ABI.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libsm2.so.0");
}
