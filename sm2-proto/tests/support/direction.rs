//! The two directions of control frames, so that each property is written once.

use proptest::prelude::*;
use serde_json::Value;
use sm2_proto::{
    Datagram, FdFacts, Violation,
    control::{decode_to_manager, decode_to_node, encode_to_manager, encode_to_node},
};

use crate::{naive, support::edit::edit};

pub(crate) const FDS: [FdFacts; 3] = [FdFacts {
    regular: false,
    size_bytes: 0,
    seals: sm2_proto::Seals(0),
}; 3];

/// The meaning of a frame, and its bytes after another encoding.
pub(crate) type Decoded = Result<(Value, Vec<u8>), Violation>;

/// One of the two directions, so that each property is written once.
pub(crate) struct Direction {
    pub(crate) decode: fn(&Datagram<'_>) -> Decoded,
    pub(crate) naive: fn(&[u8], usize, bool) -> Result<Value, &'static str>,
    pub(crate) fds: fn(&[u8]) -> usize,
}

pub(crate) const TO_MANAGER: Direction = Direction {
    decode: |datagram| {
        let frame = decode_to_manager(datagram)?;
        Ok((json(&frame), encode_to_manager(&frame)))
    },
    naive: naive::to_manager,
    fds: |bytes| usize::from(bytes.first() == Some(&9)),
};

pub(crate) const TO_NODE: Direction = Direction {
    decode: |datagram| {
        let frame = decode_to_node(datagram)?;
        Ok((json(&frame), encode_to_node(&frame)))
    },
    naive: naive::to_node,
    fds: |bytes| usize::from(matches!(bytes.first(), Some(4 | 10))),
};

pub(crate) fn json(frame: &impl serde::Serialize) -> Value {
    serde_json::to_value(frame).expect("a frame has a meaning")
}

pub(crate) fn datagram(bytes: &[u8], fds: usize) -> Datagram<'_> {
    Datagram {
        fds: &FDS[..fds],
        ..Datagram::new(bytes)
    }
}

impl Direction {
    /// Both decoders agree, and an accepted frame has only this encoding. With and without the loss
    /// of further descriptors.
    pub(crate) fn agrees(&self, bytes: &[u8], fds: usize) -> Result<(), TestCaseError> {
        self.agrees_with(bytes, fds, false)?;
        self.agrees_with(bytes, fds, true)
    }

    fn agrees_with(&self, bytes: &[u8], fds: usize, some_lost: bool) -> Result<(), TestCaseError> {
        let datagram = Datagram {
            control_truncated: some_lost,
            ..datagram(bytes, fds)
        };
        let decoded = (self.decode)(&datagram);
        if let Ok((_, again)) = &decoded {
            prop_assert_eq!(again, bytes);
        }
        let decoded = decoded.map(|(meaning, _)| meaning);
        let naive = (self.naive)(bytes, fds, some_lost);
        prop_assert_eq!(decoded.map_err(|it| it.kind().name()), naive);
        Ok(())
    }

    pub(crate) fn violation(&self, bytes: &[u8]) -> Option<Violation> {
        let fds = (self.fds)(bytes);
        let violation = (self.decode)(&datagram(bytes, fds)).err();
        assert_eq!(
            (self.naive)(bytes, fds, false).err(),
            violation.map(|it| it.kind().name())
        );
        violation
    }

    /// Checks that both decoders agree on the frame, and on the frame after each of the edits.
    pub(crate) fn mutants_agree(
        &self,
        frame: &[u8],
        edits: &[(u16, u8, u8)],
    ) -> Result<(), TestCaseError> {
        let mut bytes = frame.to_vec();
        let fds = (self.fds)(frame);
        self.agrees(&bytes, fds)?;
        for &one in edits {
            edit(&mut bytes, one);
            self.agrees(&bytes, fds)?;
        }
        Ok(())
    }
}
