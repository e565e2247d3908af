//! The body of the fuzz target `manager_session`.
//!
//! The bytes are a list of operations on a few connections to a Manager with small quotas. The
//! first byte of an operation holds its kind in the lower half and the connection in the upper
//! half. The bytes after it are the operands that [`Fuzz::step`] reads.

use alloc::{collections::BTreeSet, sync::Arc, vec::Vec};
use core::time::Duration;

use super::{Credentials, Input, Manager, Output};
use crate::{
    Code, Contract, Datagram, EntityId, FdFacts, Instant, InterfaceId, LinkId, LinkKey, Machine,
    NodeId, Seals,
    control::{
        Key, Limit, Limits, PolicyProblem, SchemaText, ToManager, decode_to_node, encode_to_manager,
    },
    fuzz::script::{Script, key_of},
    policy::{AccessPolicy, Effect, Tables},
};

const EPOCH: u64 = 1;
const LIMITS: Limits = Limits::all(u32::MAX)
    .with(Limit::Greeting, 2_000)
    .with(Limit::Recovery, 3_000)
    .with(Limit::Confirmation, 3_000)
    .with(Limit::GreetingsPerUser, 3)
    .with(Limit::SessionsPerUser, 3)
    .with(Limit::InterfacesPerSession, 6)
    .with(Limit::InterfacesPerUser, 10)
    .with(Limit::LinksPerSession, 8)
    .with(Limit::SchemaBytesPerSession, 50)
    .with(Limit::RefusalsPerSession, 2)
    .with(Limit::UnlinkedPerSession, 3)
    .with(Limit::ChangesRemembered, 20)
    .with(Limit::LinksInFlight, 256)
    .with(Limit::WorkPerTurn, 256);
const CONNECTIONS: usize = 8;
const SOCKET: FdFacts = FdFacts {
    regular: false,
    size_bytes: 0,
    seals: Seals(0),
};
const FDS: [FdFacts; 2] = [SOCKET; 2];
/// Descriptors that may come with COUNTERS: each check is failed by one of them.
const FILES: [FdFacts; 4] = [
    FdFacts {
        regular: true,
        size_bytes: 1_024,
        seals: Seals::POOLED,
    },
    SOCKET,
    FdFacts {
        regular: true,
        size_bytes: 1_024,
        seals: Seals::SEAL,
    },
    FdFacts {
        regular: true,
        size_bytes: 1_025,
        seals: Seals::POOLED,
    },
];

/// The Manager takes any bytes and sends only frames that a node accepts. It never sends more than
/// its links call for, and nothing to a session that it has hung up on.
//= SM2-FRM-001, SM2-SES-005, SM2-SES-006 fuzz
pub(crate) fn session(data: &[u8]) {
    let mut fuzz = Fuzz {
        script: Script::new(data),
        manager: Manager::new(EPOCH, 7, LIMITS),
        now: Instant(0),
        connections: [NodeId(0); CONNECTIONS],
        connected: 0,
        open: BTreeSet::new(),
        counting: BTreeSet::new(),
        shortage: 0,
    };
    while fuzz.step().is_some() {}
    for session in fuzz.connections {
        fuzz.feed(Input::Closed { session });
    }
    for session in fuzz.open.clone() {
        fuzz.feed(Input::Closed { session });
    }
    // A policy may still be applied.
    while fuzz.manager.deadline().is_some_and(|at| at <= fuzz.now) {
        fuzz.feed(Input::Tick);
    }
    assert_eq!((fuzz.manager.sessions(), fuzz.manager.links()), (0, 0));
    assert_eq!(fuzz.manager.deadline(), None);
}

struct Fuzz<'a> {
    script: Script<'a>,
    manager: Manager,
    now: Instant,
    connections: [NodeId; CONNECTIONS],
    connected: u64,
    /// The sessions that have connected and were not hung up on.
    open: BTreeSet<NodeId>,
    /// The sessions whose counters are kept.
    counting: BTreeSet<NodeId>,
    /// The number of links to come that find no descriptors.
    shortage: u8,
}

impl<'a> Fuzz<'a> {
    /// Does one operation; `None` when the bytes are used up.
    fn step(&mut self) -> Option<()> {
        let operation = self.script.byte()?;
        let at = usize::from(operation >> 4) % CONNECTIONS;
        let session = self.connections[at];
        match operation & 0xf {
            0 => self.connect(at),
            1 => {
                let bytes = self.script.bytes()?;
                self.datagram(session, Datagram::new(bytes));
            }
            2 => {
                let flags = self.script.byte()?;
                let datagram = Datagram {
                    bytes: self.script.bytes()?,
                    fds: &FDS[..usize::from(flags & 3) % FDS.len()],
                    data_truncated: flags & 4 != 0,
                    control_truncated: flags & 8 != 0,
                };
                self.datagram(session, datagram);
            }
            3 => self.feed(Input::Closed { session }),
            4 => self.feed(Input::Stalled { session }),
            5 => {
                let pause = Duration::from_millis(u64::from(self.script.byte()?) * 20);
                self.now = self.now.after(pause);
                self.feed(Input::Tick);
            }
            6 => self.shortage = self.script.byte()? % 8,
            7 => self.feed(Input::Shutdown),
            8 => self.reload(session)?,
            9 => {
                let file = usize::from(self.script.byte()?) % FILES.len();
                let frame = encode_to_manager(&ToManager::Counters);
                let datagram = Datagram {
                    fds: &FILES[file..=file],
                    ..Datagram::new(&frame)
                };
                self.datagram(session, datagram);
            }
            _ => {
                let frame = encode_to_manager(&self.frame()?);
                self.datagram(session, Datagram::new(&frame));
            }
        }
        Some(())
    }

    /// RELOAD or SUSPENDED, or a policy that was read. One session in four belongs to no user who may ask.
    fn reload(&mut self, session: NodeId) -> Option<()> {
        let choice = self.script.byte()?;
        let tables = |default| Tables {
            default,
            rules: Vec::new(),
            bindings: Vec::new(),
            exclusive: Vec::new(),
        };
        let policy = |effect| AccessPolicy::new(tables(effect)).ok().map(Arc::new);
        match choice % 5 {
            0 | 1 => {
                let frame = match choice & 0x40 {
                    0 => ToManager::Reload,
                    _ => ToManager::Suspended {
                        interface: self.interface()?,
                    },
                };
                self.datagram(session, Datagram::new(&encode_to_manager(&frame)));
            }
            2 => self.feed(Input::SetAccessPolicy(None)),
            3 => {
                let is_allowed = choice & 0x80 == 0;
                let effect = if is_allowed {
                    Effect::Allow
                } else {
                    Effect::Deny
                };
                self.feed(Input::SetAccessPolicy(policy(effect)));
            }
            _ => self.feed(Input::AccessPolicyUnusable {
                problem: PolicyProblem::Invalid,
                text: "no policy",
            }),
        }
        Some(())
    }

    fn connect(&mut self, at: usize) {
        self.connected += 1;
        let session = NodeId(self.connected);
        self.connections[at] = session;
        self.open.insert(session);
        let uid = u32::from(at & 3 == 0);
        let credentials = Credentials {
            uid,
            gid: 0,
            pid: 1,
        };
        self.feed(Input::Connected {
            session,
            credentials,
        });
    }

    /// A legal frame with few names and small numbers.
    fn frame(&mut self) -> Option<ToManager> {
        Some(match self.script.byte()? % 12 {
            0 => {
                let choice = self.script.byte()?;
                ToManager::Hello {
                    min_version: u16::from(choice % 4),
                    max_version: 2,
                    name: self.script.name()?,
                    resuming: choice & 4 != 0,
                }
            }
            1 => ToManager::Declare {
                interface: self.interface()?,
                contract: self.contract()?,
            },
            2 => ToManager::Withdraw {
                interface: self.interface()?,
            },
            3 => ToManager::Unlinked {
                interface: self.interface()?,
                link: self.link()?,
                code: Code(0),
            },
            4 => ToManager::Query {
                after: Some(self.key()?),
            },
            5 => ToManager::Goodbye { code: Code(0) },
            6 => {
                let choice = self.script.byte()?;
                ToManager::Claim {
                    interface: self.interface()?,
                    link: self.link()?,
                    key: LinkKey(u64::from(choice & 1)),
                    version: 1 + u16::from(choice & 2),
                    reliable: choice & 4 != 0,
                    sealed: choice & 8 != 0,
                }
            }
            7 => ToManager::Claimed,
            8 => ToManager::Watch {
                after: self.revision()?,
            },
            9 => ToManager::Inspect { node: self.node()? },
            10 => {
                let (data, text) = self.script.schema()?;
                ToManager::Schema(SchemaText { data, text })
            }
            _ => ToManager::Describe {
                data: self.script.schema()?.0,
            },
        })
    }

    fn node(&mut self) -> Option<NodeId> {
        Some(NodeId(self.script.byte()?.into()))
    }

    fn interface(&mut self) -> Option<InterfaceId> {
        Some(InterfaceId(self.script.byte()?.into()))
    }

    fn entity(&mut self) -> Option<EntityId> {
        Some(EntityId {
            node: self.node()?,
            interface: self.interface()?,
        })
    }

    /// A link of this Manager or of another one.
    fn link(&mut self) -> Option<LinkId> {
        let serial = self.script.byte()?;
        Some(LinkId {
            epoch: EPOCH + u64::from(serial >> 7),
            serial: u64::from(serial & 0x7f),
        })
    }

    fn key(&mut self) -> Option<Key> {
        let choice = self.script.byte()?;
        key_of(self, choice, Self::entity, Self::link)
    }

    /// The domain's revision, or one before or after it.
    fn revision(&mut self) -> Option<u64> {
        let ago = u64::from(self.script.byte()? % 32);
        Some((self.manager.revision() + 2).saturating_sub(ago))
    }

    /// A legal contract.
    fn contract(&mut self) -> Option<Contract> {
        let choice = self.script.byte()?;
        self.script.contract_as(choice, 1)
    }

    fn datagram(&mut self, session: NodeId, datagram: Datagram<'_>) {
        self.feed(Input::Datagram { session, datagram });
    }

    fn feed(&mut self, input: Input<'_>) {
        // One answer, one hang-up, the sessions that did not greet in time, the watchers, those that
        // wait for a policy, the suspended interfaces, the links, and the claims.
        let links = self.manager.links() + LIMITS.links_per_session();
        let sessions = self.manager.sessions();
        let suspended = sessions * LIMITS.count(Limit::InterfacesPerSession);
        let most = 2 + 3 * sessions + suspended + 3 * links + sessions * LIMITS.links_per_session();
        let taken = self.manager.handle(self.now, input);
        taken.expect("session numbers grow");
        let outputs: Vec<Output> = core::iter::from_fn(|| self.manager.poll()).collect();
        assert!(outputs.len() <= most, "{} outputs", outputs.len());
        for output in outputs {
            self.carry_out(output);
        }
    }

    fn carry_out(&mut self, output: Output) {
        match output {
            Output::Send { session, frame } => self.send(session, &frame, 0),
            Output::Link { link, ends } if self.shortage > 0 => {
                self.shortage -= 1;
                for (session, frame) in &ends {
                    self.send(*session, frame, 1);
                }
                self.feed(Input::LinkFailed { link });
            }
            Output::Link { ends, .. } => {
                for (session, frame) in &ends {
                    self.send(*session, frame, 1);
                }
            }
            Output::KeepCounters { session } => {
                assert!(self.counting.insert(session), "{session} counts once");
            }
            Output::SendCounters { session, frame, of } => {
                assert!(self.counting.contains(&of), "{of} keeps no counters");
                self.send(session, &frame, 1);
            }
            Output::ReadAccessPolicy => {}
            Output::HangUp {
                session, goodbye, ..
            } => {
                self.counting.remove(&session);
                if let Some(goodbye) = goodbye {
                    self.send(session, &goodbye, 0);
                }
                assert!(self.open.remove(&session), "{session} is hung up on once");
            }
        }
    }

    fn send(&self, session: NodeId, frame: &[u8], fds: usize) {
        assert!(self.open.contains(&session), "{session} is over");
        let datagram = Datagram {
            fds: &FDS[..fds],
            ..Datagram::new(frame)
        };
        decode_to_node(&datagram).expect("a node accepts what a Manager sends");
    }
}
