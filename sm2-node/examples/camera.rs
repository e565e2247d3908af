//! A camera and a viewer that share memory: `camera [FRAMES]`.
//!
//! Each image is written once, into memory that the viewer reads in place. No byte is copied, whatever the
//! size.

use std::error::Error;
use std::io::{Write, stdout};
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use sm2_node::zerocopy::little_endian::{U32, U64};
use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
use sm2_node::{Message, Node, Rate, RecvError, Shutdown, WaitError, now};

/// Also of a thread.
type Outcome = Result<(), Box<dyn Error + Send + Sync>>;

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
    match film_and_view() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("camera: {error}");
            ExitCode::FAILURE
        }
    }
}

fn film_and_view() -> Outcome {
    let frames = match std::env::args().nth(1) {
        Some(text) => text.parse()?,
        None => 30,
    };
    let shutdown = Shutdown::on_signals()?;
    let end = shutdown.clone();
    let viewer = thread::spawn(move || view(frames, &end));
    film(frames, &shutdown, || viewer.is_finished())?;
    viewer.join().expect("the viewer does not panic")
}

fn film(frames: u32, shutdown: &Shutdown, nobody_looks: impl Fn() -> bool) -> Outcome {
    let node = Node::builder("camera").shutdown(shutdown).connect()?;
    let topic = node.publisher_builder::<Image>("camera/image");
    let publisher = topic
        .reliable(true)
        .publish_timeout(Duration::from_secs(1))
        .declare()?;
    match publisher.wait_for_subscribers(1) {
        Err(WaitError::Shutdown) => return Ok(()),
        waited => waited?,
    }
    let mut rate = Rate::hz(30);
    for frame in 0..frames {
        let mut image = publisher.loan_slice((WIDTH * HEIGHT) as usize)?;
        image.exposed_ns = now().0.into();
        image.width = WIDTH.into();
        image.height = HEIGHT.into();
        image.pixels.fill(frame as u8);
        image.publish()?;
        if rate.sleep_unless(shutdown).is_none() || nobody_looks() {
            break;
        }
    }
    match publisher.flush_timeout(Duration::from_secs(1)) {
        Err(WaitError::Shutdown) => Ok(()),
        flushed => Ok(flushed.map(drop)?),
    }
}

fn view(frames: u32, shutdown: &Shutdown) -> Outcome {
    let node = Node::builder("viewer").shutdown(shutdown).connect()?;
    let topic = node.subscriber_builder::<Image>("camera/image");
    let subscriber = topic.reliable(true).declare()?;
    for _ in 0..frames {
        let image = match subscriber.recv() {
            Err(RecvError::Shutdown) => return Ok(()),
            image => image?,
        };
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
