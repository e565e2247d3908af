//! A replay in lockstep gives the same outputs at any speed.

// Shows LCK-INPUTS (test), bound: 100 replays through three nodes at three speeds; a member that fails; subscribers
// without room.

use std::os::fd::AsFd;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use sm2_bag::{Bag, Options, PlayOptions, PlayReport, Player};
use sm2_node::clock::DomainTime;
use sm2_node::executor::Failure;
use sm2_node::lockstep::{Inputs, InputsError};
use sm2_node::{Node, Publisher, Sample, Shutdown};

use crate::common::{Domain, SOON, named, record};

const MESSAGES: u64 = 20;

/// How often the same bag is played.
const RUNS: usize = if cfg!(feature = "slow") { 100 } else { 4 };

/// The outputs of a run: domain time and payload.
type Outputs = Vec<(u64, Vec<u8>)>;

/// A node that ends with the shutdown.
fn member(domain: &Domain, name: &str, shutdown: &Shutdown) -> Node {
    let builder = Node::builder(name).socket(domain.path("sock"));
    builder.shutdown(shutdown).connect().unwrap()
}

/// Records the numbers on the topics `left` and `right`.
fn record_numbers(domain: &Domain) {
    let talker = domain.node("talker");
    let topics = ["left", "right"].map(|it| talker.publisher::<u64>(it).unwrap());
    let node = domain.node("recorder");
    let options = Options {
        sync_interval: Duration::from_millis(1),
        ..Options::new(named(&["left", "right"]))
    };
    record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| {
            let is_open = |it: &Publisher<u64>| it.links().iter().any(|it| it.open);
            topics.iter().all(is_open)
        });
        for number in 0..MESSAGES {
            topics[number as usize % 2].publish(&number).unwrap();
            record_until(&mut |it| it.progress().messages > number);
            if number % 3 == 0 {
                thread::sleep(Duration::from_millis(1));
            }
        }
    });
}

/// Two results for each number.
fn detect(node: &Node) -> Result<(), InputsError> {
    let mut found = node
        .publisher_builder::<u64>("found")
        .reliable(true)
        .declare()?;
    let mut inputs = Inputs::new(node)?;
    inputs.only_in_lockstep(true);
    for topic in ["left", "right"] {
        let numbers = node
            .subscriber_builder::<u64>(topic)
            .reliable(true)
            .depth(64);
        let handle = |found: &mut Publisher<u64>, number: Sample<u64>, _| {
            found.publish(&(*number * 2))?;
            found.publish(&(*number * 2 + 1))?;
            Ok(())
        };
        inputs
            .on_message(numbers.declare()?, handle)
            .map_err(InputsError::Io)?;
    }
    inputs.run(&mut found)
}

/// The sum of the results, once in each 2 ms of domain time.
fn filter(node: &Node) -> Result<(), InputsError> {
    let publisher = node
        .publisher_builder::<[u64]>("sum")
        .reliable(true)
        .declare()?;
    let found = node
        .subscriber_builder::<u64>("found")
        .reliable(true)
        .depth(64)
        .declare()?;
    let mut inputs = Inputs::new(node)?;
    inputs.only_in_lockstep(true);
    let on_found = |sum: &mut Vec<u64>, it: Sample<u64>, _| -> Result<(), Failure> {
        sum.push(*it);
        Ok(())
    };
    inputs
        .on_message(found, on_found)
        .map_err(InputsError::Io)?;
    inputs.on_tick(Duration::from_millis(2), |sum: &mut Vec<u64>, _, _| {
        publisher.publish(sum.as_slice())?;
        sum.clear();
        Ok(())
    });
    inputs.run(&mut Vec::new())
}

/// Everything that the others publish.
fn log(node: &Node) -> Result<Outputs, InputsError> {
    let mut inputs = Inputs::new(node)?;
    inputs.only_in_lockstep(true);
    for topic in ["left", "found", "right"] {
        let numbers = node
            .subscriber_builder::<u64>(topic)
            .reliable(true)
            .depth(64);
        let handle = |outputs: &mut Outputs, it: Sample<u64>, now: DomainTime| {
            outputs.push((now.0, it.to_le_bytes().into()));
            Ok(())
        };
        inputs
            .on_message(numbers.declare()?, handle)
            .map_err(InputsError::Io)?;
    }
    let sums = node
        .subscriber_builder::<[u64]>("sum")
        .reliable(true)
        .depth(64)
        .declare()?;
    let on_sum = |outputs: &mut Outputs, it: Sample<[u64]>, now: DomainTime| {
        let bytes = it.iter().flat_map(|it| it.to_le_bytes());
        outputs.push((now.0, bytes.collect()));
        Ok(())
    };
    inputs.on_message(sums, on_sum).map_err(InputsError::Io)?;
    let mut outputs = Vec::new();
    inputs.run(&mut outputs)?;
    Ok(outputs)
}

/// Plays the bag in lockstep.
fn play(domain: &Domain, members: usize, rate: f64) -> PlayReport {
    let bags = [Bag::open(&domain.path("bag")).unwrap()];
    let options = PlayOptions {
        rate,
        lockstep: Some(members),
        ..PlayOptions::default()
    };
    let connect = |name: &str| Node::builder(name).socket(domain.path("sock")).connect();
    let (stop, writer) = std::io::pipe().unwrap();
    let mut player = Player::new(&bags, options, connect, stop.as_fd()).unwrap();
    let (done, is_over) = mpsc::channel::<()>();
    thread::scope(|scope| {
        // The end of the pipe ends a replay that waits for ever: it is incomplete then.
        scope.spawn(move || {
            let _ = is_over.recv_timeout(SOON);
            drop(writer);
        });
        let played = player.play();
        drop(done);
        played.unwrap()
    })
}

/// Plays the bag through detector, filter and logger, and returns the logger's outputs.
fn replay(domain: &Domain, rate: f64) -> Outputs {
    let shutdown = Shutdown::new().unwrap();
    let nodes = ["logger", "detector", "filter"].map(|it| member(domain, it, &shutdown));
    let [logger, detector, filterer] = &nodes;
    thread::scope(|scope| {
        let logged = scope.spawn(|| log(logger).unwrap());
        let detected = scope.spawn(|| detect(detector).unwrap());
        let filtered = scope.spawn(|| filter(filterer).unwrap());
        let report = play(domain, 3, rate);
        shutdown.request();
        assert!(report.complete && report.left.is_empty(), "{report:?}");
        detected.join().unwrap();
        filtered.join().unwrap();
        logged.join().unwrap()
    })
}

//= SM2-LCK-005, SM2-LCK-006 test
#[test]
fn a_replay_gives_the_same_outputs_at_any_speed() {
    let domain = Domain::new();
    record_numbers(&domain);
    let first = replay(&domain, 0.0);
    let numbers = first.iter().filter(|it| it.1.len() == 8).count() as u64;
    assert!(numbers >= 3 * MESSAGES, "{numbers}");
    assert!(first.iter().any(|it| it.1.len() > 8), "no sums: {first:?}");
    for run in 1..RUNS {
        let rate = match run {
            // As long as the recording took, and slower.
            1 if cfg!(feature = "slow") => 0.1,
            1..=6 if cfg!(feature = "slow") => 1.0,
            1 => 1.0,
            _ => 0.0,
        };
        let outputs = replay(&domain, rate);
        let same = outputs
            .iter()
            .zip(&first)
            .take_while(|(a, b)| a == b)
            .count();
        let length = first.len().max(outputs.len());
        let (got, expected) = (outputs.get(same), first.get(same));
        assert_eq!(
            same, length,
            "run {run} at {rate}x: {got:?} instead of {expected:?}"
        );
    }
}

//= SM2-LCK-007 test
#[test]
fn the_replay_goes_on_without_a_member_that_is_gone() {
    let domain = Domain::new();
    record_numbers(&domain);
    let shutdown = Shutdown::new().unwrap();
    let [short, long] = ["short", "long"].map(|it| member(&domain, it, &shutdown));
    let handled = thread::scope(|scope| {
        let short = scope.spawn(move || {
            let mut inputs = Inputs::new(&short).unwrap();
            let numbers = short.subscriber_builder::<u64>("left").reliable(true);
            let fail = |(): &mut (), number: Sample<u64>, _| match *number {
                10 => Err("ten".into()),
                _ => Ok(()),
            };
            inputs.on_message(numbers.declare().unwrap(), fail).unwrap();
            inputs.run(&mut ()).unwrap_err()
        });
        let long = scope.spawn(|| log(&long).unwrap());
        let report = play(&domain, 2, 0.0);
        shutdown.request();
        assert!(report.complete, "{report:?}");
        assert_eq!(report.left, ["short"]);
        let error = short.join().unwrap();
        assert!(matches!(error, InputsError::Callback(it) if it.to_string() == "ten"));
        long.join().unwrap()
    });
    assert_eq!(handled.len() as u64, MESSAGES);
}

/// A member whose subscriber has no room for the messages of a turn ends with an error.
fn overwhelmed(reliable: bool) -> InputsError {
    let domain = Domain::new();
    record_numbers(&domain);
    let shutdown = Shutdown::new().unwrap();
    let [burst, slow] = ["burst", "slow"].map(|it| member(&domain, it, &shutdown));
    thread::scope(|scope| {
        let burst = scope.spawn(move || {
            let mut many = burst
                .publisher_builder::<u64>("many")
                .depth(64)
                .reliable(true)
                .declare()
                .unwrap();
            let mut inputs = Inputs::new(&burst).unwrap();
            let numbers = burst.subscriber_builder::<u64>("left").reliable(true);
            let publish = |many: &mut Publisher<u64>, _: Sample<u64>, _| {
                for number in 0..20 {
                    many.publish(&number)?;
                }
                Ok(())
            };
            inputs
                .on_message(numbers.declare().unwrap(), publish)
                .unwrap();
            let _ = inputs.run(&mut many);
        });
        let slow = scope.spawn(move || {
            let mut inputs = Inputs::new(&slow).unwrap();
            let many = slow.subscriber_builder::<u64>("many").reliable(reliable);
            let many = many.depth(2).max_borrowed(2).declare().unwrap();
            inputs.on_message(many, |(): &mut (), _, _| Ok(())).unwrap();
            inputs.run(&mut ()).unwrap_err()
        });
        let report = play(&domain, 2, 0.0);
        shutdown.request();
        assert_eq!(report.left, ["slow"]);
        burst.join().unwrap();
        slow.join().unwrap()
    })
}

//= SM2-LCK-006 test
#[test]
fn messages_without_room_end_the_lockstep() {
    for reliable in [true, false] {
        let lost = overwhelmed(reliable);
        assert!(
            matches!(&lost, InputsError::Lost { topic, .. } if topic.as_str() == "many"),
            "{lost}"
        );
    }
}
