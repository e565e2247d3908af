//! `sm2-model-viewer SCOPE [ADDRESS]`: shows a scope of the model in a browser.
//! `sm2-model-viewer --count SCOPE`: counts its moments with stateright, and with the model's own
//! search.
//!
//! Status 0: both counts are equal; 1: they differ, or a property is broken; 2: there is no such
//! scope, or the address cannot be used.

use std::env;
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::process::ExitCode;

use sm2_model_viewer::{Counted, Watchable, Watched, count};
use sm2_verification::model::{domain::Scope, explore, link::LinkScope};
use stateright::Model as _;

const USAGE: &str = "usage: sm2-model-viewer SCOPE [ADDRESS]
       sm2-model-viewer --count SCOPE
ADDRESS is 127.0.0.1:3000 if it is not given; whoever can reach it can look.";

/// The task for a scope.
enum Task {
    Count,
    Serve(SocketAddr),
}

fn main() -> ExitCode {
    let args: Vec<_> = env::args().skip(1).collect();
    let args: Vec<_> = args.iter().map(String::as_str).collect();
    let (task, name) = match args[..] {
        ["--help" | "-h"] => return say(USAGE, ExitCode::SUCCESS),
        ["--count", name] => (Task::Count, name),
        [name] if !name.starts_with('-') => (Task::Serve((Ipv4Addr::LOCALHOST, 3000).into()), name),
        [name, address] if !name.starts_with('-') => match address.parse() {
            Ok(address) => (Task::Serve(address), name),
            Err(_) => return refuse(&format!("{address} is no address like 127.0.0.1:3000")),
        },
        _ => return refuse(USAGE),
    };
    match (Scope::named(name), LinkScope::named(name)) {
        (Some(scope), _) => task.run(name, &scope),
        (_, Some(scope)) => task.run(name, &scope),
        (None, None) => refuse(&unknown(name)),
    }
}

impl Task {
    fn run<S: Watchable + Clone>(self, name: &str, scope: &S) -> ExitCode {
        match self {
            Self::Count => compare(name, scope),
            Self::Serve(address) => serve(name, scope.clone(), address),
        }
    }
}

/// Runs both searches, and prints their counts side by side.
fn compare<S: Watchable + Clone>(name: &str, scope: &S) -> ExitCode {
    let theirs = count(scope.clone());
    let ours = Counted::from(explore(scope, usize::MAX));
    let mut text = String::new();
    for (who, it) in [("stateright", theirs), ("own search", ours)] {
        let held = if it.held { "all held" } else { "NOT all held" };
        let _ = writeln!(
            text,
            "{name}, {who}: {} states, {} transitions, depth {}, {held}",
            it.states, it.transitions, it.depth
        );
    }
    let equal = ours == theirs;
    text.push_str(if equal { "equal" } else { "NOT EQUAL" });
    say(&text, ExitCode::from(u8::from(!equal || !ours.held)))
}

fn serve<S: Watchable>(name: &str, scope: S, address: SocketAddr) -> ExitCode {
    // The server itself would panic.
    if let Err(error) = TcpListener::bind(address) {
        return refuse(&format!("cannot listen on {address}: {error}"));
    }
    say(
        &format!("{name} is at http://{address}/"),
        ExitCode::SUCCESS,
    );
    Watched::new(scope).checker().serve(address);
    ExitCode::SUCCESS
}

fn unknown(name: &str) -> String {
    let domain = Scope::all().into_iter().map(|it| it.name);
    let links = LinkScope::all().into_iter().map(|it| it.name);
    let all: Vec<_> = domain.chain(links).collect();
    format!("there is no scope {name}; there are: {}", all.join(", "))
}

fn say(text: &str, code: ExitCode) -> ExitCode {
    match writeln!(io::stdout(), "{text}") {
        Ok(()) => code,
        Err(_) => ExitCode::FAILURE,
    }
}

fn refuse(text: &str) -> ExitCode {
    let _ = writeln!(io::stderr(), "{text}");
    ExitCode::from(2)
}
