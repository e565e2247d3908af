//! Publishes images of 640 x 480 pixels, with a bright object before a dark wall.

use sm2_example_robot::Image;
use sm2_node::{Node, Rate, Shutdown, now};

fn main() -> anyhow::Result<()> {
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("camera").shutdown(&shutdown).connect()?;
    let mut parameters = node.parameters_builder();
    let rate_hz = parameters
        .parameter("rate_hz", 30)
        .range(1..=120)
        .description("images in a second")
        .add();
    let exposure_ms = parameters
        .parameter("exposure_ms", 8.0)
        .range(0.1..=30.0)
        .description("the time of exposure, in milliseconds")
        .add();
    let _parameters = parameters.declare()?;

    let images = node.publisher::<Image>("camera/image")?;
    let mut rate = Rate::hz(rate_hz.get() as u32);
    while let Some(tick) = rate.sleep_unless(&shutdown) {
        let mut image = images.loan_slice(640 * 480)?;
        image.time_ns = now().0.into();
        (image.width, image.height) = (640.into(), 480.into());
        image.pixels.fill((exposure_ms.get() * 4.0) as u8);
        let left = tick.number as usize % 600;
        image.pixels[left..left + 40].fill(255);
        image.publish()?;
        rate.set_hz(rate_hz.get() as u32);
    }
    Ok(())
}
