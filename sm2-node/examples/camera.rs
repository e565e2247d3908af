//! A camera and a viewer that share memory: `camera [FRAMES]`.
//!
//! Each image is written once, into memory that the viewer reads in place. No byte of it is
//! copied, whatever its size.

use std::error::Error;
use std::thread;
use std::time::Duration;

use sm2_node::zerocopy::little_endian::{U32, U64};
use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
use sm2_node::{Message, Node, now};

/// A header, and as many pixels as there are.
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

fn main() -> Result<(), Box<dyn Error>> {
    let frames = std::env::args().nth(1).map_or(Ok(30), |it| it.parse())?;
    let viewer = thread::spawn(move || view(frames).map_err(|error| error.to_string()));
    film(frames)?;
    viewer.join().expect("the viewer does not panic")?;
    Ok(())
}

fn film(frames: u32) -> Result<(), Box<dyn Error>> {
    let node = Node::new("camera")?;
    let topic = node.publisher_builder::<Image>("camera/image");
    let publisher = topic.reliable(Duration::from_secs(1)).declare()?;
    publisher.wait_for_subscribers(1, None)?;
    for frame in 0..frames {
        let mut image = publisher.loan_slice((WIDTH * HEIGHT) as usize)?;
        image.exposed_ns = now().0.into();
        image.width = WIDTH.into();
        image.height = HEIGHT.into();
        image.pixels.fill(frame as u8);
        image.publish()?;
        node.spin_for(Duration::from_millis(33))?;
    }
    publisher.flush(Duration::from_secs(1))?;
    Ok(())
}

fn view(frames: u32) -> Result<(), Box<dyn Error>> {
    let node = Node::new("viewer")?;
    let topic = node.subscriber_builder::<Image>("camera/image");
    let subscriber = topic.reliable(true).declare()?;
    for _ in 0..frames {
        let image = subscriber.recv()?;
        let age = Duration::from_nanos(now().0 - image.exposed_ns.get());
        let brightness = u64::from(image.pixels[0]);
        let (width, height) = (image.width, image.height);
        println!("{width} x {height}, brightness {brightness}, {age:?} old");
    }
    Ok(())
}
