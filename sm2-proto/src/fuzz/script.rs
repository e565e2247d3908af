//! Bytes as a list of choices among few names and small numbers, so that they meet.

use alloc::{string::String, vec::Vec};

use crate::{
    Code, Contract, Demand, InterfaceId, LinkId, Name, NodeId, Offer, Place, Quota, Refusal,
    ServiceQos, TypeId,
    control::{Apart, Change, Item, Key, Limits},
    schema::Schema,
};

const NAMES: [&str; 4] = ["a", "b", "c", "d/e"];
const TEXTS: [&str; 4] = ["plain:u8", "postcard:string", "postcard:u64", "plain:"];

/// The bytes, spent from the front. Every method gives `None` when they are used up.
pub(crate) struct Script<'a>(pub(crate) &'a [u8]);

impl<'a> Script<'a> {
    pub(crate) fn byte(&mut self) -> Option<u8> {
        let (&byte, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(byte)
    }

    /// As many as a byte says, or what is left.
    pub(crate) fn bytes(&mut self) -> Option<&'a [u8]> {
        let len = usize::from(self.byte()?).min(self.0.len());
        let (bytes, rest) = self.0.split_at(len);
        self.0 = rest;
        Some(bytes)
    }

    /// Small, but for one in 256.
    pub(crate) fn number(&mut self) -> Option<u64> {
        Some(match self.byte()? {
            u8::MAX => u64::MAX,
            byte => u64::from(byte % 8),
        })
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

    pub(crate) fn place(&mut self) -> Option<Place> {
        Some(Place {
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

    /// A type and its text, or one that is not its.
    pub(crate) fn schema(&mut self) -> Option<(TypeId, String)> {
        let choice = usize::from(self.byte()?);
        let text = TEXTS[choice % TEXTS.len()];
        let hash = Schema::parse(text).map_or(1, |schema| schema.hash());
        let hash = hash ^ u64::from(choice > 200);
        let name = self.name()?;
        Some((TypeId { name, hash }, text.into()))
    }

    pub(crate) fn contract(&mut self) -> Option<Contract> {
        let choice = self.byte()?;
        let [reliable, sealed, stated] = [4, 8, 16].map(|bit| choice & bit != 0);
        let name = self.name()?;
        let data = TypeId {
            name: self.name()?,
            hash: 0,
        };
        // Zero is out of range.
        let (depth, max_borrowed) = (u16::from(choice != u8::MAX), 1);
        let qos = ServiceQos {
            depth,
            max_borrowed,
            sealed,
        };
        let demand = Demand {
            depth,
            reliable,
            max_borrowed,
            sealed,
        };
        let offer = Offer {
            depth,
            reliable,
            latched: 0,
            sealed,
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
        Some(match self.byte()? % 4 {
            0 => Refusal::NameTaken,
            1 => Refusal::Version { min: 2, max: 3 },
            2 => Refusal::TopicType {
                theirs: self.schema()?.0,
            },
            _ => Refusal::Quota {
                quota: Quota::InterfacesPerUser,
                limit: 1,
            },
        })
    }

    pub(crate) fn key(&mut self) -> Option<Key> {
        Some(match self.byte()? % 5 {
            0 => Key::Domain,
            1 => Key::Member {
                place: self.place()?,
            },
            2 => Key::Link {
                link: self.link()?,
                offering: self.place()?,
            },
            3 => Key::Claim {
                link: self.link()?,
                place: self.place()?,
            },
            _ => Key::Apart {
                offering: self.place()?,
                demanding: self.place()?,
            },
        })
    }

    pub(crate) fn item(&mut self) -> Option<Item> {
        let choice = self.byte()?;
        let [reliable, sealed] = [128, 64].map(|bit| choice & bit != 0);
        Some(match choice % 7 {
            0 => Item::Domain {
                limits: Limits {
                    links_per_session: u32::from(choice),
                    seal_all: sealed,
                    ..Limits::default()
                },
            },
            1 => Item::Node {
                node: self.node()?,
                name: self.name()?,
                uid: u32::from(sealed),
                pid: -1,
                resuming: reliable,
            },
            2 => Item::Interface {
                place: self.place()?,
                contract: self.contract()?,
            },
            3 => Item::Refusal {
                place: self.place()?,
                contract: self.contract()?,
                reason: self.refusal()?,
            },
            4 => Item::Link {
                link: self.link()?,
                offering: self.place()?,
                demanding: self.place()?,
                version: 1,
                reliable,
                sealed,
            },
            5 => Item::Claim {
                link: self.link()?,
                place: self.place()?,
            },
            _ => Item::Apart {
                offering: self.place()?,
                demanding: self.place()?,
                cause: match choice % 3 {
                    0 => Apart::Ended { code: self.code()? },
                    1 => Apart::Quota {
                        node: self.node()?,
                        limit: 1,
                    },
                    _ => Apart::Descriptors,
                },
            },
        })
    }

    pub(crate) fn items(&mut self) -> Option<Vec<Item>> {
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
