//! `connect`: a process that connects to a Manager, greets if it has a name, and stays.

use std::{io, process::ExitCode};

use sm2_io::SeqPacket;
use sm2_tests::{options::Options, raw::RawNode};

pub(crate) fn run(options: &Options) -> ExitCode {
    let path: std::path::PathBuf = options.get("--socket").expect("--socket");
    let (_node, _connection);
    if let Some(name) = options.get::<String>("--name") {
        _node = RawNode::welcomed(&path, &name);
        println!("welcome");
    } else {
        _connection = SeqPacket::connect(&path);
        match &_connection {
            Ok(_) => println!("connected"),
            Err(error) => println!("{}", error.kind()),
        }
    }
    // Stays connected until the test closes standard input.
    let _ = io::copy(&mut io::stdin(), &mut io::sink());
    ExitCode::SUCCESS
}
