//! A player is paused, stepped and given another rate.

use std::os::fd::AsFd;
use std::slice;
use std::thread;

use sm2_bag::{
    Bag, Options, PlayCommand, PlayCommandError, PlayControl, PlayError, PlayOptions, PlayReport,
    PlayStatus, Player,
};
use sm2_node::clock::DomainTime;
use sm2_node::lockstep::Inputs;
use sm2_node::{Call, Client, ConnectError, Name, Node, Sample, Shutdown, Subscriber};

use crate::common::{Domain, SOON, named, record};

const MESSAGES: u64 = 6;

/// Records the numbers from 0 on.
fn bag() -> (tempfile::TempDir, Bag) {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let numbers = talker.publisher::<u64>("numbers").unwrap();
    let node = domain.node("recorder");
    let options = Options::new(named(&["numbers"]));
    record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| numbers.links().iter().any(|it| it.open));
        for number in 0..MESSAGES {
            numbers.publish(&number).unwrap();
            record_until(&mut |it| it.progress().messages > number);
        }
    });
    let bag = Bag::open(&domain.path("bag")).unwrap();
    (domain.folder, bag)
}

/// A player that publishes as fast as it can, and begins with a pause.
fn paused() -> PlayOptions {
    PlayOptions {
        rate: 0.0,
        paused: true,
        ..PlayOptions::default()
    }
}

fn connect(domain: &Domain) -> impl Fn(&str) -> Result<Node, ConnectError> {
    let socket = domain.path("sock");
    move |name| Node::builder(name).socket(&socket).connect()
}

/// Plays a bag in a thread while `direct` runs, which gets the player's control and a node.
fn play(
    bag: &Bag,
    options: PlayOptions,
    direct: impl FnOnce(&PlayControl, &Node),
) -> Result<PlayReport, PlayError> {
    let domain = Domain::new();
    let node = domain.node("director");
    let shutdown = Shutdown::new().unwrap();
    let connect = connect(&domain);
    let bags = slice::from_ref(bag);
    let mut player = Player::new(bags, options, connect, shutdown.as_fd()).unwrap();
    let name = Name::new("play/control").unwrap();
    player.serve(&node, &name).unwrap();
    let control = player.control();
    thread::scope(|scope| {
        let played = scope.spawn(move || player.play());
        // Also if the test fails.
        let end = End(shutdown.clone());
        direct(&control, &node);
        let played = played.join().unwrap();
        drop(end);
        played
    })
}

/// Ends a player when it is dropped.
struct End(Shutdown);

impl Drop for End {
    fn drop(&mut self) {
        self.0.request();
    }
}

fn send(control: &PlayControl, commands: &[PlayCommand]) {
    for command in commands {
        control.send(*command).unwrap();
    }
}

/// Calls the service of a player.
fn call(client: &Client<str, str>, command: PlayCommand) -> PlayStatus {
    let reply = client.call_timeout(&command.to_string(), SOON).unwrap();
    serde_json::from_str(&reply).unwrap()
}

#[test]
fn a_step_publishes_one_message() {
    let (_folder, bag) = bag();
    let report = play(&bag, paused(), |control, node| {
        let client = node.client::<str, str>("play/control").unwrap();
        client.wait_for_servers_timeout(1, SOON).unwrap();
        let before = call(&client, PlayCommand::Pause);
        assert_eq!(
            (before.paused, before.messages, before.time_ns),
            (true, 0, None)
        );
        for steps in 1..=3 {
            let status = call(&client, PlayCommand::Step);
            assert_eq!((status.paused, status.messages), (true, steps));
            assert!(status.time_ns >= bag.report().start_ns);
            // Another call finds the player as the step has left it.
            assert_eq!(call(&client, PlayCommand::Pause), status);
        }
        assert_eq!(control.status().messages, 3);
        let status = call(&client, PlayCommand::Rate(2.0));
        assert_eq!(
            (status.paused, status.rate, status.messages),
            (true, 2.0, 3)
        );
        call(&client, PlayCommand::Resume);
    });
    let report = report.unwrap();
    assert!(report.complete);
    assert_eq!(report.topics[0].messages, MESSAGES);
}

#[test]
fn calls_that_are_no_commands_fail() {
    let (_folder, bag) = bag();
    let report = play(&bag, paused(), |control, node| {
        let client = node.client::<str, str>("play/control").unwrap();
        client.wait_for_servers_timeout(1, SOON).unwrap();
        for (text, reason) in [
            ("stop", PlayCommandError::Unknown),
            ("rate -1", PlayCommandError::Rate),
        ] {
            let failed = client.call_timeout(text, SOON).unwrap_err();
            assert!(failed.to_string().contains(&reason.to_string()), "{failed}");
        }
        // The second message is due in some hundred years.
        send(control, &[PlayCommand::Rate(1e-12), PlayCommand::Resume]);
        let failed = client.call_timeout("step", SOON).unwrap_err();
        let reason = PlayCommandError::NotPaused.to_string();
        assert!(failed.to_string().contains(&reason), "{failed}");
        control.end();
    });
    let report = report.unwrap();
    assert!(!report.complete);
}

#[test]
fn a_call_for_a_step_ends_with_the_replay() {
    let (_folder, bag) = bag();
    let options = PlayOptions {
        subscribers: 1,
        ..paused()
    };
    let report = play(&bag, options, |control, node| {
        let client = node.client::<str, str>("play/control").unwrap();
        client.wait_for_servers_timeout(1, SOON).unwrap();
        // A call for each message, and one more.
        let calls = (0..=MESSAGES).map(|_| client.send_timeout("step", SOON).unwrap());
        let calls: Vec<_> = calls.collect();
        assert_eq!(call(&client, PlayCommand::Pause).messages, 0);
        let _numbers = node.subscriber::<u64>("numbers").unwrap();
        let results = calls.into_iter().map(Call::wait);
        let results: Vec<_> = results.collect();
        let (last, steps) = results.split_last().unwrap();
        for (number, step) in steps.iter().enumerate() {
            let status: PlayStatus = serde_json::from_str(step.as_ref().unwrap()).unwrap();
            assert_eq!((status.paused, status.messages), (true, number as u64 + 1));
        }
        let error = last.as_ref().unwrap_err().to_string();
        assert!(error.contains("the replay has ended"), "{error}");
        assert_eq!(control.status().messages, MESSAGES);
    });
    assert!(report.unwrap().complete);
}

/// The readings of a clock, as time and speed.
fn readings(clock: &Subscriber<[u8]>) -> Vec<(u64, u64)> {
    let samples = std::iter::from_fn(|| clock.try_recv().unwrap());
    let word =
        |bytes: &[u8], at: usize| u64::from_le_bytes(bytes[8 * at..8 * at + 8].try_into().unwrap());
    samples.map(|it| (word(&it, 0), word(&it, 2))).collect()
}

#[test]
fn domain_time_stands_still_during_a_pause() {
    let (_folder, bag) = bag();
    let options = PlayOptions {
        // The messages are done in milliseconds.
        rate: 2.0,
        clock: true,
        ..paused()
    };
    let mut found = Vec::new();
    let report = play(&bag, options, |control, node| {
        let builder = node.subscriber_builder::<[u8]>("clock").any_type();
        let clock = builder.depth(64).declare().unwrap();
        let client = node.client::<str, str>("play/control").unwrap();
        client.wait_for_servers_timeout(1, SOON).unwrap();
        clock.wait_for_publishers_timeout(1, SOON).unwrap();
        let mut times = Vec::new();
        for _ in 0..2 {
            times.push(call(&client, PlayCommand::Step).time_ns.unwrap());
        }
        // So slow that nothing more is published.
        call(&client, PlayCommand::Rate(1e-6));
        call(&client, PlayCommand::Resume);
        call(&client, PlayCommand::Pause);
        call(&client, PlayCommand::Rate(3.0));
        found = readings(&clock);
        // Where a step leads is where the clock stands.
        assert!(
            times.iter().all(|it| found.contains(&(*it, 0))),
            "{found:?}"
        );
        let last = &found[found.len() - 3..];
        assert_eq!(last[0], (times[1], 0));
        assert_eq!(last[1], (times[1], 1_000));
        assert_eq!(last[2].1, 0);
        assert!(last[2].0 >= times[1]);
        call(&client, PlayCommand::Resume);
        let resumed = readings(&clock);
        assert_eq!(resumed[0], (last[2].0, 3_000_000_000), "{resumed:?}");
        control.end();
    });
    report.unwrap();
    assert!(found.is_sorted_by_key(|it| it.0), "{found:?}");
}

#[test]
fn a_step_of_a_lockstep_has_all_messages_of_a_time() {
    let (_folder, bag) = bag();
    let bags = [bag];
    let double = Bag::open(bags[0].path()).unwrap();
    let bags = [bags.into_iter().next().unwrap(), double];
    let domain = Domain::new();
    let node = domain.node("director");
    let options = PlayOptions {
        lockstep: Some(1),
        ..paused()
    };
    let shutdown = Shutdown::new().unwrap();
    let member = Node::builder("member").socket(domain.path("sock"));
    let member = member.shutdown(&shutdown).connect().unwrap();
    let connect = connect(&domain);
    let mut player = Player::new(&bags, options, connect, shutdown.as_fd()).unwrap();
    let name = Name::new("play/control").unwrap();
    player.serve(&node, &name).unwrap();
    thread::scope(|scope| {
        let handled = scope.spawn(|| {
            let mut inputs = Inputs::new(&member).unwrap();
            inputs.only_in_lockstep(true);
            let numbers = member.subscriber_builder::<u64>("numbers").reliable(true);
            let numbers = numbers.depth(64).declare().unwrap();
            let push = |handled: &mut Vec<(u64, u64)>, it: Sample<u64>, now: DomainTime| {
                handled.push((now.0, *it));
                Ok(())
            };
            inputs.on_message(numbers, push).unwrap();
            let mut handled = Vec::new();
            inputs.run(&mut handled).unwrap();
            handled
        });
        let played = scope.spawn(move || player.play());
        let end = End(shutdown.clone());
        let client = node.client::<str, str>("play/control").unwrap();
        client.wait_for_servers_timeout(1, SOON).unwrap();
        // Each message is in both bags.
        for steps in 1..=MESSAGES {
            assert_eq!(call(&client, PlayCommand::Step).messages, 2 * steps);
        }
        let report = played.join().unwrap().unwrap();
        assert!(report.complete, "{report:?}");
        drop(end);
        let handled = handled.join().unwrap();
        let numbers: Vec<_> = handled.iter().map(|it| it.1).collect();
        let twice = (0..MESSAGES).flat_map(|it| [it, it]);
        assert_eq!(numbers, twice.collect::<Vec<_>>());
    });
}

#[test]
fn a_handle_ends_this_replay_and_the_next_one() {
    let (_folder, bag) = bag();
    let domain = Domain::new();
    let shutdown = Shutdown::new().unwrap();
    let connect = connect(&domain);
    let options = PlayOptions {
        rate: 0.0,
        ..PlayOptions::default()
    };
    let bags = slice::from_ref(&bag);
    let mut player = Player::new(bags, options, connect, shutdown.as_fd()).unwrap();
    assert_eq!(player.play().unwrap().topics[0].messages, MESSAGES);
    player.control().end();
    for _ in 0..2 {
        let report = player.play().unwrap();
        assert!(!report.complete);
        assert_eq!(report.topics[0].messages, MESSAGES);
    }
    assert!(player.control().has_ended());
    assert_eq!(player.control().status().messages, MESSAGES);
}
