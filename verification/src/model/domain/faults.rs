//! What the harness does wrong on purpose, to see that it is found.

use std::{collections::VecDeque, rc::Rc};

use sm2_proto::{
    InterfaceId, LinkId,
    control::{ToManager, ToNode, encode_to_manager, encode_to_node},
};

use super::world::{Down, Frame};

/// Each is found by a property: `tests/model.rs` says which one, in which scope.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fault {
    /// UNLINKED never reaches the Manager.
    UnlinkedLost,
    /// WITHDRAWN passes what was sent before it, as if there were no *dropping*.
    WithdrawnOvertakes,
    /// CLAIM carries another key than LINK did.
    OtherKey,
    /// The next Manager numbers from where the one before it began.
    EpochAgain,
    /// The Manager never sees the end of a connection.
    EndUnseen,
    /// LINK states terms that nobody asked for.
    OtherTerms,
    /// DECLARED comes twice.
    DeclaredTwice,
    /// CLAIMED never reaches the Manager.
    ClaimedLost,
    /// DECLARE never reaches the Manager.
    DeclareLost,
    /// The Manager's driver makes each link twice.
    LinkTwice,
    /// The last item of each page is lost.
    ItemLost,
    /// A connection gets the number of the one before it.
    SessionAgain,
    /// The Manager's driver does not take its outputs.
    Unpolled,
    /// A node's driver closes a link that ended at the other side, and does not tell its
    /// machine.
    HangUpUnsaid,
}

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

/// What of a node's frame comes to be in its queue.
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
            *key ^= u64::from(at);
            frame.bytes = encode_to_manager(&frame.says);
        }
        _ => {}
    }
    Some(frame)
}
