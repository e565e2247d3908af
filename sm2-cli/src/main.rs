//! The `sm2` command.
fn main() {}
