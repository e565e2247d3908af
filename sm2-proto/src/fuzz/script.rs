//! Reads bytes as a list of choices among few names and small numbers, so that choices repeat.

use alloc::{string::String, vec::Vec};

use crate::{
    Code, Contract, DemandedQos, EntityId, InterfaceId, LinkId, Name, NodeId, OfferedQos, Period,
    Quota, Refusal, ServiceQos, TypeId,
    control::{Change, Item, Key, StatedLimit, StatedLimits, UnlinkedReason},
    schema::Schema,
};

const NAMES: [&str; 4] = ["a", "b", "c", "d/e"];
const TEXTS: [&str; 4] = ["plain:u8", "postcard:string", "postcard:u64", "plain:"];

/// The bytes, spent from the front. Every method returns `None` when they are used up.
#[derive(Clone, Debug)]
pub struct Script<'a>(&'a [u8]);

impl<'a> Script<'a> {
    /// A script without a spent byte.
    #[must_use]
    pub const fn new(data: &'a [u8]) -> Self {
        Self(data)
    }

    /// The next byte.
    pub fn byte(&mut self) -> Option<u8> {
        let (&byte, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(byte)
    }

    /// One of this many choices, from 0.
    ///
    /// # Panics
    ///
    /// There is no choice.
    pub fn below(&mut self, choices: u8) -> Option<usize> {
        Some(usize::from(self.byte()? % choices))
    }

    /// As many bytes as the next byte says, or the rest.
    pub fn bytes(&mut self) -> Option<&'a [u8]> {
        let len = self.byte()?;
        Some(self.at_most(len.into()))
    }

    /// This many bytes, or the rest.
    pub fn at_most(&mut self, len: usize) -> &'a [u8] {
        let (bytes, rest) = self.0.split_at(len.min(self.0.len()));
        self.0 = rest;
        bytes
    }

    /// A number that is small but for one in 256.
    pub fn number(&mut self) -> Option<u64> {
        Some(match self.byte()? {
            u8::MAX => u64::MAX,
            byte => u64::from(byte % 8),
        })
    }

    /// Mostly `right`; sometimes a number next to it, sometimes one far from it.
    pub(crate) fn near(&mut self, right: u64) -> Option<u64> {
        Some(match self.byte()? {
            0xff => right.wrapping_add(1),
            0xfe => right.wrapping_sub(1),
            0xfd => 0,
            0xfc => u64::MAX,
            _ => right,
        })
    }

    /// True for one byte in 256.
    pub(crate) fn rarely(&mut self) -> Option<bool> {
        Some(self.byte()? == u8::MAX)
    }

    pub(crate) fn name(&mut self) -> Option<Name> {
        Name::new(NAMES[usize::from(self.byte()?) % NAMES.len()]).ok()
    }

    pub(crate) fn node(&mut self) -> Option<NodeId> {
        Some(NodeId(self.number()?))
    }

    pub(crate) fn interface(&mut self) -> Option<InterfaceId> {
        Some(InterfaceId(self.number()?))
    }

    pub(crate) fn code(&mut self) -> Option<Code> {
        Some(Code(self.byte()?.into()))
    }

    pub(crate) fn entity(&mut self) -> Option<EntityId> {
        Some(EntityId {
            node: self.node()?,
            interface: self.interface()?,
        })
    }

    pub(crate) fn link(&mut self) -> Option<LinkId> {
        let serial = self.byte()?;
        Some(LinkId {
            epoch: 1 + u64::from(serial >> 7),
            serial: u64::from(serial % 8),
        })
    }

    /// A type and its text, or the text of another type.
    pub(crate) fn schema(&mut self) -> Option<(TypeId, String)> {
        let choice = usize::from(self.byte()?);
        let text = TEXTS[choice % TEXTS.len()];
        let hash = Schema::parse(text).map_or(1, |schema| schema.hash());
        let hash = hash ^ u64::from(choice > 200);
        let name = self.name()?;
        Some((TypeId { name, hash }, text.into()))
    }

    /// A contract that is legal but for one in 256.
    pub(crate) fn contract(&mut self) -> Option<Contract> {
        let choice = self.byte()?;
        // Zero is out of range.
        self.contract_as(choice, u16::from(choice != u8::MAX))
    }

    /// The contract of this number, with this depth.
    pub(crate) fn contract_as(&mut self, choice: u8, depth: u16) -> Option<Contract> {
        let [reliable, sealed, stated] = [4, 8, 16].map(|bit| choice & bit != 0);
        let name = self.name()?;
        let data = TypeId {
            name: self.name()?,
            hash: 0,
        };
        let max_borrowed = 1;
        let deadline = Period(u64::from(choice >> 5) % 3);
        let qos = ServiceQos {
            depth,
            max_borrowed,
            sealed,
        };
        let demand = DemandedQos {
            reliable,
            sealed,
            deadline,
            lease: deadline,
            ..DemandedQos::new(depth, max_borrowed)
        };
        let offer = OfferedQos {
            reliable,
            sealed,
            deadline,
            lifespan: deadline,
            lease: deadline,
            ..OfferedQos::new(depth)
        };
        Some(match choice % 4 {
            0 => Contract::Publisher {
                topic: name,
                data,
                offer,
            },
            1 => Contract::Subscriber {
                topic: name,
                data: stated.then_some(data),
                demand,
            },
            2 => Contract::Server {
                service: name,
                request: data.clone(),
                reply: data,
                qos,
            },
            _ => Contract::Client {
                service: name,
                types: stated.then(|| (data.clone(), data)),
                qos,
            },
        })
    }

    pub(crate) fn refusal(&mut self) -> Option<Refusal> {
        Some(match self.byte()? % 6 {
            0 => Refusal::NameTaken,
            1 => Refusal::Version { min: 2, max: 3 },
            2 => Refusal::TopicType {
                theirs: self.schema()?.0,
            },
            3 => Refusal::Denied { rule: None },
            4 => Refusal::Exclusive {
                rule: self.schema()?.0.name,
            },
            _ => Refusal::Quota {
                quota: Quota::InterfacesPerUser,
                limit: 1,
            },
        })
    }

    pub(crate) fn key(&mut self) -> Option<Key> {
        let choice = self.byte()?;
        key_of(self, choice, Self::entity, Self::link)
    }

    pub(crate) fn item(&mut self) -> Option<Item> {
        let choice = self.byte()?;
        let [reliable, sealed] = [128, 64].map(|bit| choice & bit != 0);
        Some(match choice % 8 {
            0 => Item::Domain {
                limits: StatedLimits {
                    limits: alloc::vec![StatedLimit {
                        name: self.name()?,
                        value: u32::from(choice),
                    }],
                    seal_all: sealed,
                    waive_user_boundary: reliable,
                },
            },
            1 => Item::Node {
                node: self.node()?,
                name: self.name()?,
                uid: u32::from(sealed),
                pid: -1,
                resuming: reliable,
                max_links: sealed.then_some(u32::from(choice)),
            },
            2 => Item::Interface {
                entity: self.entity()?,
                contract: self.contract()?,
            },
            3 => Item::Refusal {
                entity: self.entity()?,
                contract: self.contract()?,
                reason: self.refusal()?,
            },
            4 => Item::Link {
                link: self.link()?,
                offering: self.entity()?,
                demanding: self.entity()?,
                version: 1,
                reliable,
                sealed,
            },
            5 => Item::Claim {
                link: self.link()?,
                entity: self.entity()?,
            },
            6 => Item::Waiting {
                link: self.link()?,
                offering: self.entity()?,
                demanding: self.entity()?,
            },
            _ => Item::Unlinked {
                offering: self.entity()?,
                demanding: self.entity()?,
                reason: match choice % 3 {
                    0 => UnlinkedReason::Ended { code: self.code()? },
                    1 => UnlinkedReason::Quota {
                        node: self.node()?,
                        limit: 1,
                    },
                    _ => UnlinkedReason::Descriptors,
                },
            },
        })
    }

    /// Up to seven items of a domain, in any order, with few names and small numbers.
    pub fn items(&mut self) -> Option<Vec<Item>> {
        let count = self.byte()? % 8;
        (0..count).map(|_| self.item()).collect()
    }

    pub(crate) fn changes(&mut self) -> Option<Vec<Change>> {
        let count = self.byte()? % 8;
        let change = |_| {
            Some(if self.byte()? % 2 == 0 {
                Change::Set { item: self.item()? }
            } else {
                Change::Removed { key: self.key()? }
            })
        };
        (0..count).map(change).collect()
    }
}

/// The key of any kind, whose parts come from `entity` and `link`.
pub(crate) fn key_of<S>(
    source: &mut S,
    choice: u8,
    entity: fn(&mut S) -> Option<EntityId>,
    link: fn(&mut S) -> Option<LinkId>,
) -> Option<Key> {
    Some(match choice % 5 {
        0 => Key::Domain,
        1 => Key::Member {
            entity: entity(source)?,
        },
        2 => Key::Link {
            link: link(source)?,
            offering: entity(source)?,
        },
        3 => Key::Claim {
            link: link(source)?,
            entity: entity(source)?,
        },
        _ => Key::Unlinked {
            offering: entity(source)?,
            demanding: entity(source)?,
        },
    })
}
