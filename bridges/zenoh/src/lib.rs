//! A bridge between a domain of SM2 and a network of Zenoh.
//!
//! The bridge is an ordinary node of the domain, and an ordinary session of Zenoh. [`Config`] says which topics pass.
//!
//! | to do | see |
//! | --- | --- |
//! | run a bridge in a program | [`Config::load`], [`Bridge::start`], [`Bridge::run`] |
//! | ask why a topic passes, or does not | [`Config::explain`] |
//! | count the messages | [`Bridge::account`] |
//!
//! # Names
//!
//! [`Mode`] says which form topics and types have in the network.
//!
//! | mode | key expression of the topic `camera/image` |
//! | --- | --- |
//! | plain | `PREFIX/camera/image` |
//! | ROS 2 | `0/camera/image/sensor_msgs::msg::dds_::Image_/RIHS01_…`, as in rmw_zenoh |
//!
//! In mode plain, the type is the schema of the encoding, as in `zenoh/bytes;sm2:NAME:HASH`. A message without such a
//! schema has the type of `[u8]`. In mode ROS 2, liveliness tokens show the interfaces on both sides.
//!
//! # Durable topics
//!
//! In mode plain, rules can make topics durable: their messages are in the files of the spool until a bridge of the
//! network has published them in its domain, and has acknowledged them. They are delivered at least once. The bridge
//! that receives one a second time does not publish it again.
//!
//! # Loops
//!
//! Each message that comes from a domain has an [`Origin`] as its attachment, or at the end of it. A bridge ignores
//! the messages of the bridges of its own domain. In the domain, interfaces that stand for those of the network belong
//! to the node `remote/NAME`. Neither bridges nor gateways carry the interfaces of such nodes on.

mod bridge;
mod config;
mod convention;
mod durable;
mod network;
mod outgoing;
mod plain;
mod ready;
mod ros2;
mod sender;
mod services;
mod sides;

pub use self::bridge::Bridge;
pub use self::config::{Config, ConfigError, ConfigValueError, Mode};
pub use sm2_bridge_core::{Account, BridgeError, Counts, Origin, SpoolCounts};
