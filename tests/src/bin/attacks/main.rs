//! `cargo run --release -p sm2-tests --bin attacks -- [--seconds N] [--repeats N] [--only WORD]`: measures
//! processes beside hostile, stopped and dying ones, and prints the table of SECURITY.md.
//!
//! For each attack, windows of N seconds without it and with it follow each other. In each window a
//! subscriber measures the messages of a publisher (rate, delay, losses), and a third process measures how
//! long a new subscriber takes until it is linked. A cell has the least and the greatest value of the windows
//! without the attack, then those of the windows with it. Nothing is asserted about times. Exit status: 1 if a
//! message was damaged or missing without being counted, or if a window had no message.

mod attack;
mod figures;
mod hostile;
mod hostile_links;
mod remote;
mod victims;
mod world;

use std::{process::ExitCode, thread, time::Duration};

use sm2_tests::options::Options;

use self::{
    attack::{ATTACKS, Attack},
    figures::{Row, Window},
    world::World,
};

const USAGE: &str = "usage: attacks [--seconds N] [--repeats N] [--only WORD]";
/// The time between the beginning of an attack and its window, and between its end and the next window.
const SETTLING: Duration = Duration::from_millis(700);

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1).peekable();
    // The processes of the run are started from this program, with a role.
    if let Some(role) = arguments.next_if(|it| !it.starts_with('-')) {
        let options = Options::parse(arguments);
        return match role.as_str() {
            "manager" => sm2_tests::manager::run(&options),
            "gateway" => sm2_tests::gateway::run(&options),
            "attack" => hostile::run(&options),
            role => victims::run(role, &options),
        };
    }
    let known = ["--seconds", "--repeats", "--only"];
    let all: Vec<String> = arguments.collect();
    if !all.len().is_multiple_of(2)
        || all
            .iter()
            .step_by(2)
            .any(|it| !known.contains(&it.as_str()))
    {
        eprintln!("{USAGE}");
        return ExitCode::from(2);
    }
    let options = Options::parse(all.into_iter());
    let seconds = Duration::from_secs_f64(options.get_or("--seconds", 3.0));
    let repeats = options.get_or("--repeats", 3);
    let only: String = options.get_or("--only", String::new());
    let mut is_good = true;
    println!("{}", figures::HEADER);
    for attack in ATTACKS.iter().filter(|it| it.name.contains(&only)) {
        let row = measure(attack, seconds, repeats);
        println!("{}", row.markdown(attack.name));
        is_good &= row.is_good();
    }
    match is_good {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    }
}

/// Measures one attack in a domain of its own.
fn measure(attack: &Attack, seconds: Duration, repeats: usize) -> Row {
    let mut world = World::start();
    let mut row = Row::default();
    for _ in 0..repeats {
        row.without.push(window(&mut world, seconds));
        let mut running = attack.begin(&mut world);
        thread::sleep(SETTLING);
        world.begin();
        running.go_on(&mut world, seconds);
        // A process that waits for a stopped one answers when that goes on.
        running.end(&mut world);
        row.with.push(world.end());
        thread::sleep(SETTLING);
    }
    row
}

fn window(world: &mut World, seconds: Duration) -> Window {
    world.begin();
    thread::sleep(seconds);
    world.end()
}
