//! `gateway --config PATH`: a gateway. It prints its address once it runs.

use std::{io, path::PathBuf, process::ExitCode};

use sm2_gateway::{Config, Gateway};
use sm2_tests::options::Options;
use tokio::runtime::Builder;

pub(crate) fn run(options: &Options) -> ExitCode {
    let path: PathBuf = options.get("--config").expect("--config");
    let config = Config::load(&path).expect("a configuration");
    let runtime = Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build();
    let runtime = runtime.expect("threads");
    let gateway = runtime.block_on(Gateway::start(&config));
    let gateway = gateway.expect("a gateway");
    println!("{}", gateway.address());
    // Until the test ends.
    let _ = io::copy(&mut io::stdin(), &mut io::sink());
    ExitCode::SUCCESS
}
