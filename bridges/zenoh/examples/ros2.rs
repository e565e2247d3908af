//! A camera driver, a detector and a viewer in ROS 2, and a router for them. The book's chapter "Moving a pipeline"
//! moves the detector to SM2 (example `detector`).
//!
//! ```sh
//! cargo run --example ros2 router
//! cargo run --example ros2 camera
//! cargo run --example ros2 detector
//! cargo run --example ros2 viewer
//! ```

use std::error::Error;
use std::time::{Duration, Instant};
use std::{env, thread};

use hiroz::Builder;
use hiroz::context::{ZContext, ZContextBuilder};
use hiroz_msgs::geometry_msgs::PointStamped;
use hiroz_msgs::sensor_msgs::Image;
use zenoh::Wait;
use zenoh::internal::buffers::SplitBuffer as _;

const ROUTER: &str = "tcp/127.0.0.1:7447";
const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

fn main() -> Result<()> {
    match env::args().nth(1).as_deref() {
        Some("router") => router(),
        Some("camera") => camera(&context()?),
        Some("detector") => detector(&context()?),
        Some("viewer") => viewer(&context()?),
        _ => Err("one of: router, camera, detector, viewer".into()),
    }
}

/// Stands for `ros2 run rmw_zenoh_cpp rmw_zenohd`.
fn router() -> Result<()> {
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"router\"")?;
    config.insert_json5("listen/endpoints", &format!("[\"{ROUTER}\"]"))?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    let _session = zenoh::open(config).wait()?;
    println!("the router listens on {ROUTER}");
    loop {
        thread::park();
    }
}

fn context() -> Result<ZContext> {
    let builder = ZContextBuilder::default().with_mode("client");
    let builder = builder.disable_multicast_scouting();
    builder.with_connect_endpoints([ROUTER]).build()
}

/// Publishes 30 images per second. One pixel of each is bright.
fn camera(context: &ZContext) -> Result<()> {
    let node = context.create_node("camera").build()?;
    let images = node.create_pub::<Image>("/camera/image").build()?;
    for number in 0_u32.. {
        let mut pixels = vec![0; (WIDTH * HEIGHT) as usize];
        pixels[(number % (WIDTH * HEIGHT)) as usize] = 255;
        images.publish(&Image {
            height: HEIGHT,
            width: WIDTH,
            encoding: "mono8".to_owned(),
            step: WIDTH,
            data: pixels.into(),
            ..Image::default()
        })?;
        thread::sleep(Duration::from_millis(33));
    }
    Ok(())
}

/// Publishes the place of the brightest pixel of each image.
fn detector(context: &ZContext) -> Result<()> {
    let node = context.create_node("detector").build()?;
    let images = node.create_sub::<Image>("/camera/image").build()?;
    let places = node.create_pub::<PointStamped>("/detections").build()?;
    loop {
        let image = images.recv()?;
        let pixels = image.data.contiguous();
        let brightest = pixels.iter().enumerate().max_by_key(|it| it.1);
        let Some((at, _)) = brightest else { continue };
        let mut place = PointStamped {
            header: image.header,
            ..PointStamped::default()
        };
        place.point.x = f64::from(at as u32 % image.step);
        place.point.y = f64::from(at as u32 / image.step);
        places.publish(&place)?;
    }
}

/// Prints once a second how many places came, and the last one.
fn viewer(context: &ZContext) -> Result<()> {
    let node = context.create_node("viewer").build()?;
    let places = node.create_sub::<PointStamped>("/detections").build()?;
    let (mut count, mut since) = (0, Instant::now());
    loop {
        let place = places.recv()?;
        count += 1;
        if since.elapsed() >= Duration::from_secs(1) {
            println!(
                "{count} places, the last one at {} {}",
                place.point.x, place.point.y
            );
            (count, since) = (0, Instant::now());
        }
    }
}
