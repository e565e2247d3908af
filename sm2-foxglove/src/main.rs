//! The program `sm2-foxglove`; all of it is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    sm2_foxglove::program::main()
}
