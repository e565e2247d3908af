//! A viewer that reads slowly, or not at all, costs its budget, and still gets the messages of rare topics.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::thread;
use std::time::Duration;

use sm2_foxglove::Options;
use sm2_node::{Message, Publisher};
use sm2_test_support::{SOON, until};

use crate::common::{Viewer, World, address};
use crate::program::Process;

const MIB: usize = 1024 * 1024;

/// Returns once the subscribers have taken all messages.
fn until_taken<T: Message + ?Sized>(publisher: &Publisher<T>) {
    until("the messages are taken", || {
        publisher.counters().in_flight == 0
    });
}

/// A message of a type of ROS 2: the server passes it on as it is, whatever it has.
fn image(number: u32, len: usize) -> sm2_ros::sensor_msgs::msg::Image {
    sm2_ros::sensor_msgs::msg::Image {
        height: number,
        data: vec![0; len],
        ..Default::default()
    }
}

/// The number of an image in CDR: the field `height` follows the header, which ends with an empty text.
fn number_of(message: &[u8]) -> u32 {
    u32::from_le_bytes(message[20..24].try_into().unwrap())
}

/// The memory that a process has for itself, in bytes. The slots of publishers are shared memory, which does not count.
fn own_bytes(process: u32) -> usize {
    let text = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = text.lines().find_map(|it| it.strip_prefix("RssAnon:"));
    let kib = line.unwrap().trim().strip_suffix(" kB").unwrap();
    kib.parse::<usize>().unwrap() * 1024
}

#[test]
fn a_viewer_that_stops_reading_costs_its_budget() {
    const TOPICS: u32 = 10;
    const ROUNDS: u32 = 20;
    let world = World::new();
    let node = world.node("camera");
    let topics = (0..TOPICS).map(|it| format!("image/{it}"));
    let images: Vec<_> = topics.map(|it| node.publisher(&it).unwrap()).collect();
    let rare = node.publisher::<str>("status").unwrap();
    let process = Process::start(&world.socket(), &["--viewer-budget-mib", "16"]);
    let mut viewer = Viewer::connect(&process.url);
    for (topic, images) in images.iter().enumerate() {
        viewer.subscribe(&format!("image/{topic}"));
        images.wait_for_subscribers_timeout(1, SOON).unwrap();
    }
    let of_rare = viewer.subscribe("status");
    rare.wait_for_subscribers_timeout(1, SOON).unwrap();
    let own = || own_bytes(process.child.id());
    let (before, mut most) = (own(), 0);

    // 800 MiB; the viewer reads nothing of them. Without the budget, ten messages of 4 MiB would wait.
    for round in 0..ROUNDS {
        for images in &images {
            images.publish(&image(round, 4 * MIB)).unwrap();
            until_taken(images);
            most = most.max(own());
        }
        rare.publish(&round.to_string()).unwrap();
        until_taken(&rare);
    }
    let cost = most.saturating_sub(before);
    println!(
        "a viewer that stops reading: {} MiB with a budget of 16 MiB, for 800 MiB of messages",
        cost / MIB
    );
    // The budget, and a message of slack for the allocator.
    assert!(cost < 20 * MIB, "{cost} bytes");

    // The viewer reads again: all rare messages are there.
    for round in 0..ROUNDS {
        let found = viewer.message(of_rare);
        let expected = format!("{{\"value\":\"{round}\"}}");
        assert_eq!(*found.data, *expected.as_bytes());
    }
}

/// Forwards connections to `url` at a limited rate. Returns the address.
fn slow_link(url: &str, bytes_per_ms: usize) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let own = listener.local_addr().unwrap().to_string();
    let server = address(url).to_owned();
    thread::spawn(move || {
        let (viewer, _) = listener.accept().unwrap();
        let server = TcpStream::connect(server).unwrap();
        // The buffers of the kernel are part of the link: small ones, so that the link is slow from the first byte on.
        socket2::SockRef::from(&server)
            .set_recv_buffer_size(16 * 1024)
            .unwrap();
        let (mut up_from, mut up_to) = (viewer.try_clone().unwrap(), server.try_clone().unwrap());
        thread::spawn(move || {
            let _ = std::io::copy(&mut up_from, &mut up_to);
            let _ = up_to.shutdown(Shutdown::Both);
        });
        let (mut from, mut to) = (server, viewer);
        let mut buffer = vec![0; bytes_per_ms];
        while let Ok(len @ 1..) = from.read(&mut buffer) {
            thread::sleep(Duration::from_millis(1));
            if to.write_all(&buffer[..len]).is_err() {
                break;
            }
        }
    });
    own
}

#[test]
fn a_viewer_behind_a_slow_link_gets_rare_topics_completely() {
    const RARE: usize = 50;
    let world = World::new();
    let node = world.node("camera");
    let images = node.publisher("image").unwrap();
    let rare = node.publisher::<str>("status").unwrap();
    let foxglove = world.foxglove(Options {
        viewer_budget_bytes: 16 * MIB,
        ..Options::default()
    });
    let link = slow_link(&foxglove.url, 8 * 1024);
    let mut viewer = Viewer::over(TcpStream::connect(link).unwrap(), &foxglove.url);
    let of_images = viewer.subscribe("image");
    let of_rare = viewer.subscribe("status");
    images.wait_for_subscribers_timeout(1, SOON).unwrap();
    rare.wait_for_subscribers_timeout(1, SOON).unwrap();

    // Each rare message comes after ten images of 200 kB, which are more than the link carries meanwhile.
    let mut sent = 0;
    let mut newest = 0;
    for at in 0..RARE {
        for _ in 0..10 {
            images.publish(&image(sent, 200_000)).unwrap();
            until_taken(&images);
            sent += 1;
        }
        rare.publish(&at.to_string()).unwrap();
        until_taken(&rare);
        let found = viewer.message(of_rare);
        assert_eq!(*found.data, *format!("{{\"value\":\"{at}\"}}").as_bytes());
    }
    let mut received = 0;
    while newest + 1 < sent {
        newest = number_of(&viewer.message(of_images).data);
        received += 1;
    }
    println!(
        "a slow link: {RARE} of {RARE} rare messages, and {received} of {sent} images, the newest included"
    );
}
