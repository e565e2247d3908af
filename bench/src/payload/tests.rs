use super::{COUNTED, HEADER_BYTES, Header, Torn, check, fill, peek, stamp};

fn written(number: u64, len: usize) -> Vec<u8> {
    let mut message = vec![0xaa; len];
    let header = Header {
        number,
        flags: COUNTED,
        start_ns: 5,
        handed_ns: 0,
    };
    fill(header, &mut message);
    message
}

#[test]
fn what_was_written_is_whole_whatever_its_length() {
    for len in [32, 33, 39, 40, 64, 1_055, 1_056, 4_096, 100_003] {
        let header = check(&written(7, len)).unwrap();
        assert_eq!((header.number, header.flags, header.start_ns), (7, 1, 5));
    }
}

#[test]
fn every_byte_of_the_body_counts() {
    for len in [64, 67, 2_051] {
        for at in HEADER_BYTES..len {
            let mut message = written(7, len);
            message[at] ^= 0x10;
            assert_eq!(check(&message), Err(Torn), "byte {at} of {len}");
        }
    }
}

#[test]
fn a_message_that_is_half_the_next_one_is_torn() {
    for len in [96, 40_000, 1 << 20] {
        let (old, new) = (written(7, len), written(8, len));
        for cut in [HEADER_BYTES + 8, len / 2, len - 8] {
            let torn = [&new[..cut], &old[cut..]].concat();
            assert_eq!(check(&torn), Err(Torn), "cut at {cut} of {len}");
        }
    }
}

#[test]
fn a_shifted_message_is_torn() {
    let message = written(7, 4_104);
    let shifted = [&message[..HEADER_BYTES], &message[HEADER_BYTES + 8..]].concat();
    assert_eq!(check(&shifted), Err(Torn));
}

#[test]
fn a_message_without_header_is_torn() {
    assert_eq!(check(&[0; 31]), Err(Torn));
    assert_eq!(peek(&[]), Err(Torn));
}

#[test]
fn the_stamp_is_part_of_the_header_alone() {
    let mut message = written(9, 256);
    stamp(&mut message, 77);
    let header = check(&message).unwrap();
    assert_eq!((header.number, header.handed_ns), (9, 77));
}
