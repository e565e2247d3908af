//! The subject of a decision: a node, and the user that its process belongs to.

use alloc::vec::Vec;

use crate::Name;

/// The names of nodes that stand for a peer of a gateway begin so (SM2-ACC-003).
const REMOTE: &str = "remote/";

/// The user and the groups of a process, as the kernel states them.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct User {
    /// The user id.
    pub uid: u32,
    /// The ids of all its groups, in any order.
    pub gids: Vec<u32>,
}

/// Conditions on users and groups. Both have to hold.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Members {
    /// The user is one of these; `None` matches every user.
    pub users: Option<Vec<u32>>,
    /// One of the user's groups is one of these; `None` matches every user.
    pub groups: Option<Vec<u32>>,
}

impl Members {
    /// Whether every user matches.
    #[must_use]
    pub const fn is_all(&self) -> bool {
        self.users.is_none() && self.groups.is_none()
    }

    /// Whether a user matches.
    #[must_use]
    pub fn has(&self, user: &User) -> bool {
        let User { uid, gids } = user;
        let users = self.users.as_ref();
        let groups = self.groups.as_ref();
        users.is_none_or(|it| it.contains(uid))
            && groups.is_none_or(|it| gids.iter().any(|gid| it.contains(gid)))
    }

    /// The number of users and groups that are listed.
    pub(super) fn len(&self) -> usize {
        let count = |it: &Option<Vec<u32>>| it.as_ref().map_or(0, Vec::len);
        count(&self.users) + count(&self.groups)
    }
}

/// A node and its user: the subject of a decision.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Subject {
    user: User,
    node: Name,
    peer: Option<Name>,
}

impl Subject {
    /// The subject of a node with this name. A node `remote/PEER` stands for the peer PEER.
    //= SM2-ACC-003
    #[must_use]
    pub fn new(user: User, node: Name) -> Self {
        let peer = node.as_str().strip_prefix(REMOTE);
        let peer = peer.and_then(|it| Name::new(it).ok());
        Self { user, node, peer }
    }

    /// The user and the groups of the process.
    #[must_use]
    pub const fn user(&self) -> &User {
        &self.user
    }

    /// The name of the node.
    #[must_use]
    pub const fn node(&self) -> &Name {
        &self.node
    }

    /// The peer of a gateway that the node stands for, if it is a remote node.
    #[must_use]
    pub const fn peer(&self) -> Option<&Name> {
        self.peer.as_ref()
    }
}
