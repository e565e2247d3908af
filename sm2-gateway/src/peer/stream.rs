//! Conversions between stream identifiers and codes of SM2 and those of quinn.

use quinn_proto::{StreamId, VarInt};
use sm2_proto::{Code, gateway::StreamToken};

pub(super) fn quic_code(code: Code) -> VarInt {
    VarInt::from_u32(code.0.into())
}

pub(super) fn token(id: StreamId) -> StreamToken {
    StreamToken(id.into())
}

pub(super) fn stream_id(stream: StreamToken) -> StreamId {
    StreamId::from(VarInt::from_u64(stream.0).unwrap_or(VarInt::MAX))
}
