//! The addresses of the two hosts of a link.

use std::net::{IpAddr, Ipv4Addr};

use sm2_lossy_link::host_address;

use crate::job::Side;

/// The IPv4 address of a host.
#[must_use]
pub fn address(side: Side) -> Ipv4Addr {
    match host_address(side.into(), false) {
        IpAddr::V4(address) => address,
        IpAddr::V6(_) => Ipv4Addr::UNSPECIFIED,
    }
}

impl From<Side> for sm2_lossy_link::Side {
    fn from(side: Side) -> Self {
        match side {
            Side::Near => Self::Near,
            Side::Far => Self::Far,
        }
    }
}
