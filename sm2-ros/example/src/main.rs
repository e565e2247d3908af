//! One process publishes an image and the state of a wheel, and serves a service; another one prints what it receives.
//!
//! `sm2-ros-example publish` and `sm2-ros-example echo`, in a domain whose Manager runs (`sm2 manager`).

use std::error::Error;
use std::time::Duration;

use sm2_node::Node;
use sm2_ros::sensor_msgs::msg::Image;
use sm2_ros::{Service, std_msgs::msg::Header};

use self::ros::my_msgs::{
    msg::Wheel,
    srv::{SetSpeed, SetSpeedRequest, SetSpeedResponse},
};

/// The types of the definitions in `msgs/`.
mod ros {
    sm2_ros::include_types!();
}

/// Longer than any wait of this program.
const TIMEOUT: Duration = Duration::from_secs(60);

fn main() -> Result<(), Box<dyn Error>> {
    match std::env::args().nth(1).as_deref() {
        Some("publish") => publish(),
        Some("echo") => echo(),
        _ => Err("usage: sm2-ros-example publish|echo".into()),
    }
}

/// Publishes ten times a second, until the process is ended.
fn publish() -> Result<(), Box<dyn Error>> {
    let node = Node::new("robot")?;
    let images = node.publisher::<Image>("image")?;
    let wheels = node.publisher::<Wheel>("wheel")?;
    let speeds = SetSpeed::server(&node, "set_speed")?;
    let mut header = Header::default();
    header.stamp.sec = 7;
    "front".clone_into(&mut header.frame_id);
    let image = Image {
        header: header.clone(),
        height: 2,
        width: 3,
        encoding: "mono8".to_owned(),
        step: 3,
        data: (1..=6).collect(),
        ..Image::default()
    };
    let wheel = Wheel {
        header,
        side: Wheel::RIGHT,
        speed: 1.5,
        ..Wheel::default()
    };
    loop {
        images.publish(&image)?;
        wheels.publish(&wheel)?;
        if let Some(request) = speeds.recv_timeout(Duration::from_millis(100))? {
            let accepted = request.speeds.iter().all(|it| it.abs() <= 10.0);
            let reason = if accepted { "" } else { "too fast" }.to_owned();
            request.reply(&SetSpeedResponse { accepted, reason })?;
        }
    }
}

/// Prints an image and the state of a wheel field by field, and the reply to a request.
fn echo() -> Result<(), Box<dyn Error>> {
    let node = Node::new("viewer")?;
    let images = node.subscriber::<Image>("image")?;
    let wheels = node.subscriber::<Wheel>("wheel")?;
    let speeds = SetSpeed::client(&node, "set_speed")?;

    let image = images.recv_timeout(TIMEOUT)?.ok_or("no image came")?;
    println!("header.stamp.sec: {}", image.header.stamp.sec);
    println!("header.stamp.nanosec: {}", image.header.stamp.nanosec);
    println!("header.frame_id: {}", image.header.frame_id);
    println!("height: {}", image.height);
    println!("width: {}", image.width);
    println!("encoding: {}", image.encoding);
    println!("is_bigendian: {}", image.is_bigendian);
    println!("step: {}", image.step);
    println!("data: {:?}", image.data);

    let wheel = wheels.recv_timeout(TIMEOUT)?.ok_or("no wheel came")?;
    println!("header.frame_id: {}", wheel.header.frame_id);
    println!("side: {}", wheel.side);
    println!("speed: {}", wheel.speed);
    println!("type: {}", wheel.r#type);

    speeds.wait_for_servers_timeout(1, TIMEOUT)?;
    let request = SetSpeedRequest {
        speeds: [1.0, 20.0],
    };
    let reply = speeds.call_timeout(&request, TIMEOUT)?;
    println!("accepted: {}", reply.accepted);
    println!("reason: {}", reply.reason);
    Ok(())
}

#[cfg(test)]
mod tests {
    use sm2_ros::cdr::to_vec;
    use sm2_ros::std_msgs::msg::Header;
    use sm2_ros::view;

    use super::ros::my_msgs::msg::{Odometer, Track};

    /// An array of parts with numbers, beside a part of another package.
    #[test]
    fn a_type_of_the_program_is_read_in_place() {
        let header = Header {
            frame_id: "base".to_owned(),
            ..Header::default()
        };
        let tracks = [vec![1, 2, 3], Vec::new()].map(|ticks| Track { ticks });
        let bytes = to_vec(&Odometer { header, tracks }).unwrap();
        let odometer = view::<Odometer>(&bytes).unwrap();
        assert_eq!(odometer.header.frame_id, "base");
        let ticks = odometer.tracks.iter().map(|it| it.ticks.to_vec());
        assert_eq!(ticks.collect::<Vec<_>>(), [vec![1, 2, 3], Vec::new()]);
    }
}
