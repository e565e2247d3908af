//! A camera and a viewer that share memory: `camera [FRAMES]`.
//!
//! Each image is written once, into memory that the viewer reads in place. No byte is copied, whatever the
//! size.

mod common;

use std::io::{Write, stdout};
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use common::Outcome;
use sm2_node::zerocopy::little_endian::{U32, U64};
use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
use sm2_node::{Message, Node, now};

/// A header, followed by the pixels.
#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "sensor/Image")]
#[repr(C)]
struct Image {
    exposed_ns: U64,
    width: U32,
    height: U32,
    pixels: [u8],
}

const WIDTH: u32 = 1920;
const HEIGHT: u32 = 1080;

fn main() -> ExitCode {
    common::run(film_and_view)
}

fn film_and_view() -> Outcome {
    let frames = common::argument(1, 30)?;
    let viewer = thread::spawn(move || view(frames));
    film(frames, || viewer.is_finished())?;
    viewer.join().expect("the viewer does not panic")
}

fn film(frames: u32, nobody_looks: impl Fn() -> bool) -> Outcome {
    let node = Node::new("camera")?;
    let topic = node.publisher_builder::<Image>("camera/image");
    let publisher = topic
        .reliable(true)
        .publish_timeout(Duration::from_secs(1))
        .declare()?;
    publisher.wait_for_subscribers(1)?;
    for frame in 0..frames {
        let mut image = publisher.loan_slice((WIDTH * HEIGHT) as usize)?;
        image.exposed_ns = now().0.into();
        image.width = WIDTH.into();
        image.height = HEIGHT.into();
        image.pixels.fill(frame as u8);
        image.publish()?;
        thread::sleep(Duration::from_millis(33));
        if nobody_looks() {
            break;
        }
    }
    publisher.flush_timeout(Duration::from_secs(1))?;
    Ok(())
}

fn view(frames: u32) -> Outcome {
    let node = Node::new("viewer")?;
    let topic = node.subscriber_builder::<Image>("camera/image");
    let subscriber = topic.reliable(true).declare()?;
    for _ in 0..frames {
        let image = subscriber.recv()?;
        let age = Duration::from_nanos(now().0 - image.exposed_ns.get());
        let brightness = u64::from(image.pixels[0]);
        let (width, height) = (image.width, image.height);
        writeln!(
            stdout(),
            "{width} x {height}, brightness {brightness}, {age:?} old"
        )?;
    }
    Ok(())
}
