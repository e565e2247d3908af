//! One item of a domain, with names in place of numbers, for people and as JSON.

use std::fmt;

use serde::Serialize;
use sm2_proto::{
    Farewell, LinkId, Name,
    control::{Item, UnlinkedReason},
    text::Counted,
};

use crate::{
    columns::{Column, Row},
    interfaces::InterfaceReport,
    limits::LimitsInForce,
    view::View,
};

/// An item, with names in place of numbers. Field names are part of the command's interface.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "item", rename_all = "snake_case")]
pub(super) enum NamedItem {
    /// The limits that the operator has set.
    Domain(LimitsInForce),
    Node(Node),
    /// An interface, granted or refused.
    Interface(InterfaceReport),
    Link(Link),
    /// A link of an earlier Manager that only one end has claimed so far.
    Claim {
        link: String,
        by: String,
    },
    /// A link that is made as soon as both nodes have room for it.
    Waiting {
        link: String,
        offering: String,
        demanding: String,
    },
    /// Two interfaces that match and are not linked.
    Unlinked {
        offering: String,
        demanding: String,
        reason: String,
    },
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Node {
    pub(super) id: u64,
    pub(super) name: String,
    pub(super) uid: u32,
    pub(super) pid: i32,
    /// Whether the node is still claiming the links that an earlier Manager made.
    pub(super) resuming: bool,
    /// How many ends of links the node can have at a time, if it stated one.
    pub(super) max_links: Option<u32>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Link {
    /// The Manager's epoch in hex digits, and the serial number of the link.
    pub(super) link: String,
    /// The publisher or server: `node:topic`.
    pub(super) offering: String,
    /// The subscriber or client.
    pub(super) demanding: String,
    pub(super) version: u16,
    pub(super) reliable: bool,
    pub(super) sealed: bool,
}

impl Row for Node {
    const COLUMNS: &'static [Column<Self>] = &[
        ("NODE", |it| it.name.clone()),
        ("ID", |it| it.id.to_string()),
        ("UID", |it| it.uid.to_string()),
        ("PID", |it| it.pid.to_string()),
        ("STATE", |it| match it.resuming {
            true => "resuming".to_owned(),
            false => "ready".to_owned(),
        }),
    ];
}

impl NamedItem {
    pub(super) fn new(view: &View<'_>, item: &Item) -> Self {
        match *item {
            Item::Domain { ref limits } => Self::Domain(LimitsInForce(limits.clone())),
            Item::Node {
                node,
                ref name,
                uid,
                pid,
                resuming,
                max_links,
            } => Self::Node(Node {
                id: node.0,
                name: name.to_string(),
                uid,
                pid,
                resuming,
                max_links,
            }),
            Item::Interface {
                entity,
                ref contract,
            } => Self::Interface(InterfaceReport::of(view, entity, contract, None)),
            Item::Refusal {
                entity,
                ref contract,
                ref reason,
            } => Self::Interface(InterfaceReport::of(view, entity, contract, Some(reason))),
            Item::Link {
                link,
                offering,
                demanding,
                version,
                reliable,
                sealed,
            } => Self::Link(Link {
                link: link_text(link),
                offering: view.title(offering),
                demanding: view.title(demanding),
                version,
                reliable,
                sealed,
            }),
            Item::Waiting {
                link,
                offering,
                demanding,
            } => Self::Waiting {
                link: link_text(link),
                offering: view.title(offering),
                demanding: view.title(demanding),
            },
            Item::Claim { link, entity } => Self::Claim {
                link: link_text(link),
                by: view.title(entity),
            },
            Item::Unlinked {
                offering,
                demanding,
                reason,
            } => Self::Unlinked {
                offering: view.title(offering),
                demanding: view.title(demanding),
                reason: reason_text(view, reason),
            },
        }
    }

    /// Whether the item is the node of this name, or an interface of that node.
    pub(super) fn belongs_to(&self, node: &Name) -> bool {
        match self {
            Self::Node(it) => it.name == node.as_str(),
            Self::Interface(it) => it.node == node.as_str(),
            _ => false,
        }
    }
}

impl Link {
    /// The terms of the link as a cell of a table.
    pub(super) const fn terms(&self) -> &'static str {
        match (self.reliable, self.sealed) {
            (false, false) => "best effort",
            (true, false) => "reliable",
            (false, true) => "sealed",
            (true, true) => "reliable, sealed",
        }
    }
}

/// `1f.7`: the epoch of the Manager that made the link, and the link's serial number.
pub(super) fn link_text(link: LinkId) -> String {
    format!("{:x}.{}", link.epoch, link.serial)
}

/// The reason why two interfaces are not linked.
pub(crate) fn reason_text(view: &View<'_>, reason: UnlinkedReason) -> String {
    match reason {
        UnlinkedReason::Ended { code } => match Farewell::from_code(code) {
            Some(Farewell::Done) => "one of them ended their link".into(),
            _ => format!("one of them ended their link ({code})"),
        },
        UnlinkedReason::Quota { node, limit } => {
            format!(
                "{} may not have more than {}",
                view.name_of(node),
                Counted::new(limit.into(), "link")
            )
        }
        UnlinkedReason::Descriptors => "the Manager had no descriptors".into(),
    }
}

impl fmt::Display for NamedItem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Domain(limits) => {
                f.write_str("domain:")?;
                for (at, limit) in limits.0.limits.iter().enumerate() {
                    let comma = if at == 0 { "" } else { "," };
                    write!(f, "{comma} {} {}", limit.name, limit.value)?;
                }
                Ok(())
            }
            Self::Node(Node {
                id,
                name,
                uid,
                pid,
                resuming,
                max_links: _,
            }) => {
                let state = if *resuming { ", resuming" } else { "" };
                write!(
                    f,
                    "node {name}: number {id}, process {pid} of user {uid}{state}"
                )
            }
            Self::Interface(it) => {
                write!(
                    f,
                    "{} {}:{}: {}, {}",
                    it.kind, it.node, it.name, it.types, it.qos
                )?;
                match &it.refused {
                    Some(reason) => write!(f, ", refused: {reason}"),
                    None => Ok(()),
                }
            }
            Self::Link(link) => write!(f, "link {link}"),
            Self::Waiting {
                link,
                offering,
                demanding,
            } => write!(f, "waiting link {offering} -> {demanding} ({link})"),
            Self::Claim { link, by } => write!(f, "claim of link {link} by {by}"),
            Self::Unlinked {
                offering,
                demanding,
                reason,
            } => write!(f, "unlinked {offering} -> {demanding}: {reason}"),
        }
    }
}

impl fmt::Display for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} -> {}", self.offering, self.demanding)?;
        if self.reliable {
            f.write_str(", reliable")?;
        }
        if self.sealed {
            f.write_str(", sealed")?;
        }
        write!(f, " ({})", self.link)
    }
}
