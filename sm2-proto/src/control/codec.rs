//! Encoding and canonical decoding of control frames (SM2-FRM-001, SM2-FRM-002).
//!
//! Decoding is canonical by encoding again: a decoded frame is encoded once more, and must equal the received bytes.
//! One comparison replaces a list of special cases, such as varints that are too long and odd booleans. Control frames
//! are rare enough for that.

use alloc::{rc::Rc, vec::Vec};
use core::cell::Cell;

use postcard::{Deserializer, Error, de_flavors::Flavor};
use serde::{Serialize, de::DeserializeOwned};

use super::{Change, Changes, Item, Page, SchemaText, ToManager, ToNode};
use crate::{Contract, Datagram, Violation, limits::SCHEMA_TEXT_MAX};

/// The bytes of a frame to the Manager.
#[must_use]
pub fn encode_to_manager(frame: &ToManager) -> Vec<u8> {
    encode(frame)
}

/// The bytes of a frame to a node.
#[must_use]
pub fn encode_to_node(frame: &ToNode) -> Vec<u8> {
    encode(frame)
}

/// Reads a frame from a node: exactly one, in its only encoding.
pub fn decode_to_manager(datagram: &Datagram<'_>) -> Result<ToManager, Violation> {
    datagram.check()?;
    let frame: ToManager = decode(datagram.bytes, ToManager::COUNT)?;
    match &frame {
        ToManager::Declare { contract, .. } => check_contract(contract)?,
        ToManager::Schema(SchemaText { text, .. }) => check_schema(text)?,
        _ => {}
    }
    datagram.check_fds(frame.fds())?;
    Ok(frame)
}

/// Reads a frame from the Manager: exactly one, in its only encoding.
pub fn decode_to_node(datagram: &Datagram<'_>) -> Result<ToNode, Violation> {
    datagram.check()?;
    let frame: ToNode = decode(datagram.bytes, ToNode::COUNT)?;
    match &frame {
        ToNode::Link { peer, .. } => check_contract(&peer.contract)?,
        ToNode::Page(Page { items, .. }) => items.iter().try_for_each(check_item)?,
        ToNode::Changes(Changes {
            changes: Some(changes),
            ..
        }) => changes.iter().try_for_each(|change| match change {
            Change::Set { item } => check_item(item),
            Change::Removed { .. } => Ok(()),
        })?,
        ToNode::Described {
            text: Some(text), ..
        } => check_schema(text)?,
        _ => {}
    }
    datagram.check_fds(frame.fds())?;
    Ok(frame)
}

//= SM2-FRM-003
fn check_contract(contract: &Contract) -> Result<(), Violation> {
    contract
        .check_qos()
        .map_err(|_| violation!(BadQos, "SM2-FRM-003"))
}

fn check_item(item: &Item) -> Result<(), Violation> {
    item.contract().map_or(Ok(()), check_contract)
}

//= SM2-SCH-001
const fn check_schema(text: &str) -> Result<(), Violation> {
    if text.len() <= SCHEMA_TEXT_MAX {
        Ok(())
    } else {
        Err(violation!(BadSchema, "SM2-SCH-001"))
    }
}

/// The bytes of any frame whose body is as in SPEC section 3.
pub(crate) fn encode<T: Serialize>(frame: &T) -> Vec<u8> {
    // Serializing into memory fails only for sequences of unknown length, and
    // no frame has one: each derives its Serialize over Vec and String.
    postcard::to_allocvec(frame).unwrap_or_default()
}

/// The reasons why bytes are not exactly one frame in its only encoding (SM2-FRM-001,
/// SM2-FRM-002).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DecodeError {
    /// No frame has this number.
    UnknownFrame,
    /// A field breaks the frame's definition.
    Malformed,
    /// A text is not UTF-8.
    BadUtf8,
    /// A name breaks the rules of names.
    BadName,
    /// Bytes follow the frame.
    TrailingBytes,
    /// The frame has another, canonical encoding.
    NotCanonical,
}

impl From<DecodeError> for Violation {
    fn from(error: DecodeError) -> Self {
        match error {
            DecodeError::UnknownFrame => violation!(UnknownFrame, "SM2-FRM-001"),
            DecodeError::Malformed => violation!(Malformed, "SM2-FRM-001"),
            DecodeError::BadUtf8 => violation!(BadName, "SM2-FRM-001"),
            DecodeError::BadName => violation!(BadName, "SM2-NAM-001"),
            DecodeError::TrailingBytes => violation!(TrailingBytes, "SM2-FRM-001"),
            DecodeError::NotCanonical => violation!(NotCanonical, "SM2-FRM-002"),
        }
    }
}

/// Reads one frame of this many types: exactly one, in its only encoding.
//= SM2-FRM-001, SM2-FRM-002
pub(crate) fn decode<T: Serialize + DeserializeOwned>(
    bytes: &[u8],
    frames: u32,
) -> Result<T, DecodeError> {
    let (number, _) =
        postcard::take_from_bytes::<u32>(bytes).map_err(|_| DecodeError::UnknownFrame)?;
    if number >= frames {
        return Err(DecodeError::UnknownFrame);
    }
    let text = Rc::new(Cell::new(false));
    let mut deserializer = Deserializer::from_flavor(Cut {
        rest: bytes,
        text: Rc::clone(&text),
    });
    let frame = T::deserialize(&mut deserializer).map_err(|error| match error {
        Error::DeserializeBadUtf8 => DecodeError::BadUtf8,
        // A type refused the value just read. Names are the only texts that frames refuse; all
        // other refused values are numbers of enumerations.
        Error::SerdeDeCustom if text.get() => DecodeError::BadName,
        _ => DecodeError::Malformed,
    })?;
    let rest = deserializer
        .finalize()
        .map_err(|_| DecodeError::Malformed)?;
    if !rest.is_empty() {
        return Err(DecodeError::TrailingBytes);
    }
    if encode(&frame) != bytes {
        return Err(DecodeError::NotCanonical);
    }
    Ok(frame)
}

/// Hands bytes to postcard and notes whether the last piece was a text.
struct Cut<'de> {
    rest: &'de [u8],
    text: Rc<Cell<bool>>,
}

impl<'de> Flavor<'de> for Cut<'de> {
    type Remainder = &'de [u8];
    type Source = &'de [u8];

    fn pop(&mut self) -> postcard::Result<u8> {
        let (&byte, rest) = self
            .rest
            .split_first()
            .ok_or(Error::DeserializeUnexpectedEnd)?;
        self.rest = rest;
        self.text.set(false);
        Ok(byte)
    }

    fn try_take_n(&mut self, count: usize) -> postcard::Result<&'de [u8]> {
        let (piece, rest) = self
            .rest
            .split_at_checked(count)
            .ok_or(Error::DeserializeUnexpectedEnd)?;
        self.rest = rest;
        self.text.set(true);
        Ok(piece)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.rest.len())
    }

    fn finalize(self) -> postcard::Result<&'de [u8]> {
        Ok(self.rest)
    }
}
