//! The encoding of beacons.

// Shows GW-DECODE (test), bound: each bit, each shorter length.

use sm2_proto::gateway::{BEACON_LEN, Beacon, BeaconError, GatewayId};

fn beacon() -> Beacon {
    let mut key = [0; 32];
    for (at, byte) in key.iter_mut().enumerate() {
        *byte = at as u8 + 1;
    }
    Beacon {
        port: 0x1234,
        gateway: GatewayId(key),
        epoch: 0x0102_0304_0506_0708,
    }
}

//= SM2-GWD-001 test
#[test]
fn its_bytes() {
    let mut expected = b"SM2G\x01\0\x34\x12".to_vec();
    expected.extend(1..=32);
    expected.extend([8, 7, 6, 5, 4, 3, 2, 1]);
    expected.extend([0; 8]);
    assert_eq!(beacon().to_bytes().to_vec(), expected);
    assert_eq!(Beacon::from_bytes(&expected), Ok(beacon()));
}

/// A change of any bit is refused for the right reason, or changes the field that it belongs to.
//= SM2-GWD-001 test
#[test]
fn any_other_bit() {
    let bytes = beacon().to_bytes();
    for bit in 0..8 * BEACON_LEN {
        let mut changed = bytes;
        changed[bit / 8] ^= 1 << (bit % 8);
        let read = Beacon::from_bytes(&changed);
        match bit / 8 {
            0..4 => assert_eq!(read, Err(BeaconError::Magic)),
            4..6 => assert!(matches!(read, Err(BeaconError::Version(_)))),
            48.. => assert_eq!(read, Err(BeaconError::ReservedNotZero)),
            _ => {
                let read = read.unwrap();
                assert_ne!(read, beacon());
                assert_eq!(read.to_bytes(), changed);
            }
        }
    }
    let mut no_port = bytes;
    no_port[6..8].fill(0);
    assert_eq!(Beacon::from_bytes(&no_port), Err(BeaconError::NoPort));
    for len in 0..BEACON_LEN {
        assert_eq!(Beacon::from_bytes(&bytes[..len]), Err(BeaconError::Length));
    }
    let longer = [&bytes[..], &[0]].concat();
    assert_eq!(Beacon::from_bytes(&longer), Err(BeaconError::Length));
}
