//! Finds bright objects in images. The service `detector/state` tells what it has done.

use sm2_example_robot::{Detections, DetectorState, Image};
use sm2_node::{Executor, Node, Shutdown};

/// The least brightness of an object.
const THRESHOLD: u8 = 200;

fn main() -> anyhow::Result<()> {
    let shutdown = Shutdown::on_signals()?;
    let node = Node::builder("detector").shutdown(&shutdown).connect()?;
    let images = node.subscriber::<Image>("camera/image")?;
    let detections = node.publisher::<Detections>("detections")?;
    let states = node.server::<str, DetectorState>("detector/state")?;
    let mut executor = Executor::new()?;
    executor.end_with(&shutdown)?;
    let group = executor.group(DetectorState::default());
    group.on_message(images, |state, image| {
        let image = image?;
        let row = &image.pixels[..image.width.get() as usize];
        let left = (row.iter()).position(|it| *it >= THRESHOLD);
        let bearing = left.map(|it| 0.5 - it as f32 / row.len() as f32);
        let bearings = Vec::from_iter(bearing);
        state.images += 1;
        state.lost += image.lost();
        state.objects += bearings.len() as u64;
        let time_ns = image.time_ns.get();
        detections.publish(&Detections { time_ns, bearings })?;
        Ok(())
    });
    group.on_request(states, |state, request| Ok(request?.reply(state)?));
    Ok(executor.run()?)
}
