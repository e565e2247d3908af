use super::*;

/// Lengths around words and blocks.
const LENGTHS: [usize; 8] = [16, 17, 23, 24, 4_095, 4_104, 4_105, 20_003];

fn message(number: u64, len: usize) -> Vec<u8> {
    let mut message = vec![0xaa; len];
    fill(number, &mut message);
    message
}

#[test]
fn what_is_written_passes() {
    for len in LENGTHS {
        for number in [0, 1, 299, u64::MAX] {
            assert_eq!(check(&message(number, len)), Ok(number));
        }
    }
}

#[test]
fn a_changed_byte_is_found_wherever_it_is() {
    // Each byte of the long ones would take a second.
    for (len, step) in [(16, 1), (23, 1), (4_105, 3), (9_001, 7)] {
        let mut changed = message(7, len);
        for offset in (8..len).step_by(step) {
            changed[offset] ^= 0x10;
            assert_eq!(check(&changed), Err(Damage { offset }), "of {len} bytes");
            changed[offset] ^= 0x10;
        }
        // A changed number does not belong to the bytes that follow.
        changed[3] ^= 1;
        assert!(check(&changed).is_err());
    }
}

#[test]
fn a_message_that_is_part_of_another_is_found() {
    for len in LENGTHS.into_iter().filter(|&len| len > 16) {
        let mut torn = message(8, len);
        let stale = message(7, len);
        torn[len - 1..].copy_from_slice(&stale[len - 1..]);
        assert_eq!(check(&torn), Err(Damage { offset: len - 1 }));
    }
}

#[test]
fn a_message_too_short_to_be_one_is_damaged() {
    for len in 0..8 {
        assert_eq!(check(&vec![0; len]), Err(Damage { offset: 0 }));
    }
}

/// The first numbers of splitmix64 with the seeds 0 and 1: neighbouring messages have no bytes in common.
#[test]
fn the_first_word_is_the_mixed_number() {
    assert_eq!(start(0), 0xe220_a839_7b1d_cdaf);
    assert_eq!(start(1), 0x910a_2dec_8902_5cc1);
    let [one, two] = [7, 8].map(|number| message(number, 4_096));
    let equal = one[8..]
        .iter()
        .zip(&two[8..])
        .filter(|(one, two)| one == two);
    // One byte in 256 is equal by chance.
    let count = equal.count();
    assert!(count < 64, "{count}");
}
