//! Deliberate faults of the harness, which the search must find.

use std::{collections::VecDeque, rc::Rc};

use sm2_proto::{
    InterfaceId, LinkId,
    control::{ToManager, ToNode, encode_to_manager, encode_to_node},
};

use super::{
    Fault,
    program::{Down, Frame},
};

/// Puts a frame into a node's queue.
pub(super) fn send_down(
    fault: Option<Fault>,
    mut frame: Frame<ToNode>,
    link: Option<(LinkId, InterfaceId)>,
    queue: &mut VecDeque<Down>,
) {
    match (fault, &mut frame.says) {
        (Some(Fault::WithdrawnOvertakes), ToNode::Withdrawn { .. }) => {
            return queue.push_front(Down::Frame(Rc::new(frame), link));
        }
        (Some(Fault::DeclaredTwice), ToNode::Declared { .. }) => {
            queue.push_back(Down::Frame(Rc::new(frame.clone()), link));
        }
        (Some(Fault::OtherTerms), ToNode::Link { reliable, .. }) => {
            *reliable = !*reliable;
            frame.bytes = encode_to_node(&frame.says);
        }
        _ => {}
    }
    queue.push_back(Down::Frame(Rc::new(frame), link));
}

/// A frame of a node as it arrives in its queue; `None` if a fault loses it.
pub(super) fn send_up(
    fault: Option<Fault>,
    mut frame: Frame<ToManager>,
    at: u8,
) -> Option<Frame<ToManager>> {
    match (fault, &mut frame.says) {
        (Some(Fault::UnlinkedLost), ToManager::Unlinked { .. })
        | (Some(Fault::ClaimedLost), ToManager::Claimed)
        | (Some(Fault::DeclareLost), ToManager::Declare { .. }) => return None,
        (Some(Fault::OtherKey), ToManager::Claim { key, .. }) => {
            key.0 ^= u64::from(at);
            frame.bytes = encode_to_manager(&frame.says);
        }
        _ => {}
    }
    Some(frame)
}
