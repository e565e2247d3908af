//! Replays the seeds and findings of `fuzz/` through the bodies of the fuzz targets, and some random inputs.

#[path = "../../fuzz/replay.rs"]
mod replay;

use proptest::{collection::vec, prelude::*, sample::select};
use sm2_ros::fuzz;

#[test]
fn every_seed() {
    replay::replay("ros_definition", fuzz::ros_definition);
    replay::replay("ros_message", fuzz::ros_message);
}

/// Pieces of definitions, and some that are none.
const WORDS: &[&str] = &[
    "bool a",
    "uint8[] b",
    "float64[4294967295] c",
    "string<=3 d",
    "wstring e",
    "T2 f",
    "T2[9] f",
    "p/T3[<=2] g",
    "int8 H=1",
    "string i \"#\"",
    "string j it's # k",
    "uint16[3] l [1, 2, 3]",
    "---",
    "\n",
    "\r\n",
    " ",
    "===\nMSG: p/T2\n",
    "====\nMSG: p/msg/T3\n",
    "[",
    "=",
    "#",
    "'",
];

proptest! {
    #[test]
    fn random_definitions(choice in any::<u8>(), words in vec((select(WORDS), select(&["\n", ""][..])), 0..12)) {
        let mut input = vec![choice];
        input.extend(words.iter().flat_map(|(word, end)| [word.as_bytes(), end.as_bytes()].concat()));
        fuzz::ros_definition(&input);
        // The same definition with a message.
        input.extend([0, 0, 1, 0, 0, 2, 0, 0, 0, 1, 0, 3, 0]);
        fuzz::ros_message(&input[1..]);
    }

    #[test]
    fn random_messages(
        number in any::<[u8; 2]>(),
        bytes in vec(prop_oneof![4 => Just(0_u8), 1 => Just(1), 1 => any::<u8>()], 0..200),
    ) {
        let head = [number[0] | 0x80, number[1], 0, 1, 0, 0];
        fuzz::ros_message(&[&head[..], &bytes].concat());
    }
}
