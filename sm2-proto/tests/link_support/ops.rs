//! The operations of a random run of a pair.

use proptest::prelude::*;

#[derive(Clone, Copy, Debug)]
pub(crate) struct PairConfig {
    pub(crate) reliable: bool,
    pub(crate) sealed: bool,
    pub(crate) depth: [u16; 2],
    pub(crate) max_borrowed: [u16; 2],
}

pub(crate) fn pair_config() -> impl Strategy<Value = PairConfig> {
    let small = || [1_u16..4, 1..4];
    (any::<bool>(), any::<bool>(), small(), small()).prop_map(
        |(reliable, sealed, depth, max_borrowed)| PairConfig {
            reliable,
            sealed,
            depth,
            max_borrowed,
        },
    )
}

/// An operation. `end` is 0 for the sender or caller, and 1 for the receiver or server.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Op {
    Send { end: usize, form: u8, pick: usize },
    Carry { end: usize },
    Take { end: usize },
    Release { end: usize, pick: usize },
    Cancel { pick: usize },
    Retire { end: usize, segment: u32 },
    Full { end: usize, full: bool },
    Close { end: usize, eof: bool },
}

pub(crate) fn op() -> impl Strategy<Value = Op> {
    let end = 0_usize..2;
    prop_oneof![
        60 => (end.clone(), 0_u8..3, 0_usize..4).prop_map(|(end, form, pick)| Op::Send { end, form, pick }),
        90 => end.clone().prop_map(|end| Op::Carry { end }),
        45 => end.clone().prop_map(|end| Op::Take { end }),
        30 => (end.clone(), 0_usize..4).prop_map(|(end, pick)| Op::Release { end, pick }),
        12 => (0_usize..4).prop_map(|pick| Op::Cancel { pick }),
        6 => (end.clone(), 0_u32..3).prop_map(|(end, segment)| Op::Retire { end, segment }),
        15 => (end.clone(), any::<bool>()).prop_map(|(end, full)| Op::Full { end, full }),
        1 => (end, any::<bool>()).prop_map(|(end, eof)| Op::Close { end, eof }),
    ]
}
