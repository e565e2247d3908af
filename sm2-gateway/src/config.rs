//! The configuration file of a gateway: TOML without unknown keys.

mod error;

use std::{
    collections::BTreeMap,
    fs, io,
    net::{IpAddr, Ipv6Addr, SocketAddr},
    num::{NonZeroU32, NonZeroU64},
    ops::Range,
    path::{Path, PathBuf},
    time::Duration,
};

use serde::Deserialize;
use sm2_io::quic::Congestion;
use sm2_proto::{
    Name, WrongText,
    gateway::{
        Action, Direction, GatewayId, Rule, Rules, SubjectKind,
        schedule::{PRIORITY_MAX, SendQos},
    },
};
use toml::Spanned;

pub use self::error::{ConfigError, ConfigValueError};
use crate::{
    address::{Address, system_look_up},
    domain::DomainLocation,
    hub::{DEFAULT_SEND_QOS, Policy},
    peer::{Limit, Limits},
    rule_words::{ActionWord, DirectionWord, KindWord},
    shadow::RuleSet,
};

/// The default of `listen`: every address of the machine.
const LISTEN: SocketAddr = SocketAddr::new(IpAddr::V6(Ipv6Addr::UNSPECIFIED), 7633);

/// A checked configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// The path of the file.
    pub path: PathBuf,
    /// The name of this gateway.
    pub name: Name,
    /// The address of the UDP socket.
    pub listen: SocketAddr,
    /// The path of the key file.
    pub key: PathBuf,
    /// The domain that it connects to its peers.
    pub domain: DomainLocation,
    /// The network interfaces for beacons.
    pub discovery: Vec<String>,
    /// The congestion controller of all connections.
    pub congestion: Congestion,
    /// The limits of each connection.
    pub limits: Limits,
    /// The trusted peers.
    pub peers: Vec<PeerConfig>,
    /// The rules and the parameters of what they allow.
    pub policy: Policy,
    /// The line of each rule in the file.
    pub rule_lines: Vec<usize>,
    /// Looks up the names of hosts. No key of the file: tests change it.
    #[doc(hidden)]
    pub look_up: fn(&str) -> io::Result<Vec<SocketAddr>>,
}

/// A trusted peer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PeerConfig {
    /// Its name in this file.
    pub name: Name,
    /// Its id: the public key.
    pub id: GatewayId,
    /// The addresses to try.
    pub addresses: Vec<Address>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: Spanned<String>,
    listen: Option<Spanned<String>>,
    key: PathBuf,
    domain: Option<String>,
    socket: Option<Spanned<PathBuf>>,
    #[serde(default)]
    discovery: Vec<String>,
    congestion: Option<CongestionWord>,
    #[serde(default)]
    limits: LimitsTable,
    #[serde(default)]
    peer: Vec<PeerTable>,
    #[serde(default)]
    rule: Vec<Spanned<RuleTable>>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum CongestionWord {
    Steady,
    Bbr,
    Cubic,
    NewReno,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitsTable {
    message_bytes: Option<Spanned<u64>>,
    memory_bytes: Option<Spanned<u64>>,
    gateway_bytes: Option<Spanned<u64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PeerTable {
    name: Spanned<String>,
    id: Spanned<String>,
    #[serde(default)]
    addresses: Vec<Spanned<String>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RuleTable {
    action: ActionWord,
    kind: Option<KindWord>,
    names: Spanned<String>,
    #[serde(default)]
    direction: DirectionWord,
    peers: Option<Vec<Spanned<String>>>,
    priority: Option<Spanned<u8>>,
    messages_per_s: Option<NonZeroU32>,
    bytes_per_s: Option<NonZeroU64>,
    max_age_ms: Option<u64>,
}

impl Config {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// See [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = fs::read_to_string(path).map_err(|source| ConfigError::Io {
            path: path.into(),
            source,
        })?;
        Self::parse(path, &text)
    }

    /// Checks the text of a file. Relative paths in it start at the folder of `path`.
    ///
    /// # Errors
    /// See [`ConfigError`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, ConfigError> {
        Self::parse_source(&Source {
            path,
            text,
            unknown_peers: UnknownPeers::Refused,
        })
    }

    /// As [`parse`](Self::parse), but rules may name peers that the file does not have yet. Such a
    /// name has no effect.
    ///
    /// # Errors
    /// See [`ConfigError`].
    #[cfg(feature = "program")]
    pub(crate) fn parse_without_peers(path: &Path, text: &str) -> Result<Self, ConfigError> {
        Self::parse_source(&Source {
            path,
            text,
            unknown_peers: UnknownPeers::Ignored,
        })
    }

    fn parse_source(at: &Source<'_>) -> Result<Self, ConfigError> {
        let Source { path, text, .. } = *at;
        let file: File = toml::from_str(text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            ConfigError::Toml {
                path: path.into(),
                line: at.line(&span),
                source: Box::new(error),
            }
        })?;
        let name = at.name(&file.name)?;
        let listen = match &file.listen {
            Some(listen) => at.address(listen)?,
            None => LISTEN,
        };
        let folder = path.parent().unwrap_or(Path::new(""));
        let domain = match (file.domain, file.socket) {
            (None, None) => DomainLocation::Environment,
            (Some(name), None) => DomainLocation::Name(name),
            (None, Some(socket)) => DomainLocation::Socket(folder.join(socket.into_inner())),
            (Some(_), Some(socket)) => {
                return Err(at.error(&socket.span(), ConfigValueError::DomainAndSocket));
            }
        };
        let mut peers = Vec::new();
        let mut ids = BTreeMap::new();
        for table in &file.peer {
            let peer = at.peer(table)?;
            if ids.insert(peer.name.clone(), peer.id).is_some() {
                let error = ConfigValueError::DuplicateName { name: peer.name };
                return Err(at.error(&table.name.span(), error));
            }
            if let Some(twin) = peers.iter().find(|it: &&PeerConfig| it.id == peer.id) {
                let other = twin.name.clone();
                return Err(at.error(&table.id.span(), ConfigValueError::DuplicateId { other }));
            }
            peers.push(peer);
        }
        let mut policy = Policy::default();
        let mut rule_lines = Vec::new();
        for table in &file.rule {
            let (rule, qos) = at.rule(table.get_ref(), &ids)?;
            policy.rules.0.push(rule);
            policy.send_qos.push(qos);
            rule_lines.push(at.line(&table.span()));
        }
        Ok(Self {
            path: path.into(),
            name,
            listen,
            key: folder.join(file.key),
            domain,
            discovery: file.discovery,
            congestion: match file.congestion {
                None | Some(CongestionWord::Steady) => Congestion::Steady,
                Some(CongestionWord::Bbr) => Congestion::Bbr,
                Some(CongestionWord::Cubic) => Congestion::Cubic,
                Some(CongestionWord::NewReno) => Congestion::NewReno,
            },
            limits: at.limits(&file.limits)?,
            peers,
            policy,
            rule_lines,
            look_up: system_look_up,
        })
    }

    /// The peer with this name or id.
    #[must_use]
    pub fn peer(&self, text: &str) -> Option<&PeerConfig> {
        let id = text.parse().ok();
        let is_it = |it: &&PeerConfig| it.name.as_str() == text || Some(it.id) == id;
        self.peers.iter().find(is_it)
    }

    /// The rules and the peers that they apply to.
    #[must_use]
    pub fn rule_set(&self) -> RuleSet {
        RuleSet {
            rules: self.policy.rules.clone(),
            peers: self.peers.iter().map(|it| it.id).collect(),
        }
    }

    /// The keys whose value differs in `new` and that take effect only at the next start.
    #[must_use]
    pub fn fixed_keys(&self, new: &Self) -> Vec<&'static str> {
        let domains = [self, new].map(|it| match &it.domain {
            DomainLocation::Name(name) => Some(name),
            DomainLocation::Environment | DomainLocation::Socket(_) => None,
        });
        let sockets = [self, new].map(|it| match &it.domain {
            DomainLocation::Socket(path) => Some(path),
            DomainLocation::Environment | DomainLocation::Name(_) => None,
        });
        let changed = [
            ("name", self.name != new.name),
            ("listen", self.listen != new.listen),
            ("key", self.key != new.key),
            ("domain", domains[0] != domains[1]),
            ("socket", sockets[0] != sockets[1]),
            ("discovery", self.discovery != new.discovery),
            ("congestion", self.congestion != new.congestion),
            ("limits", self.limits != new.limits),
        ];
        let changed = changed.into_iter().filter(|(_, is_other)| *is_other);
        changed.map(|(key, _)| key).collect()
    }

    /// The decision about a name, and the line of the rule that makes it. Without a matching rule the
    /// name is denied.
    #[must_use]
    pub fn explain(
        &self,
        kind: SubjectKind,
        name: &Name,
        direction: Direction,
        peer: &GatewayId,
    ) -> (Action, Option<usize>) {
        let rules: &Rules = &self.policy.rules;
        let decision = rules.decide(kind, name, direction, peer);
        let line = decision.rule.and_then(|it| self.rule_lines.get(it));
        (decision.action, line.copied())
    }
}

/// The text of a configuration, to turn positions into lines.
struct Source<'a> {
    path: &'a Path,
    text: &'a str,
    unknown_peers: UnknownPeers,
}

/// The treatment of rules that name a peer that the file does not have.
#[derive(Clone, Copy, PartialEq, Eq)]
enum UnknownPeers {
    Refused,
    #[cfg(feature = "program")]
    Ignored,
}

impl Source<'_> {
    fn line(&self, span: &Range<usize>) -> usize {
        let before = self.text.get(..span.start).unwrap_or("");
        before.matches('\n').count() + 1
    }

    fn error(&self, span: &Range<usize>, source: ConfigValueError) -> ConfigError {
        ConfigError::Value {
            path: self.path.into(),
            line: self.line(span),
            source,
        }
    }

    fn limits(&self, table: &LimitsTable) -> Result<Limits, ConfigError> {
        Ok(Limits {
            message_bytes: self.limit(table, Limit::MessageBytes)?,
            memory_bytes: self.limit(table, Limit::MemoryBytes)?,
            gateway_bytes: self.limit(table, Limit::GatewayBytes)?,
        })
    }

    /// The stated value of a limit, else its default, and at most the value of its whole.
    fn limit(&self, table: &LimitsTable, limit: Limit) -> Result<u64, ConfigError> {
        let stated = match limit {
            Limit::MessageBytes => &table.message_bytes,
            Limit::MemoryBytes => &table.memory_bytes,
            Limit::GatewayBytes => &table.gateway_bytes,
        };
        let whole = limit.whole();
        let whole = whole.map(|it| Ok((it, self.limit(table, it)?)));
        let whole = whole.transpose()?;
        let Some(stated) = stated else {
            let default = Limits::default().of(limit);
            return Ok(whole.map_or(default, |(_, most)| default.min(most)));
        };
        let value = *stated.get_ref();
        let error = match whole {
            _ if !(1..=limit.most()).contains(&value) => ConfigValueError::Limit { limit, value },
            Some((whole, most)) if value > most => ConfigValueError::LimitAboveWhole {
                limit,
                value,
                whole,
                most,
            },
            _ => return Ok(value),
        };
        Err(self.error(&stated.span(), error))
    }

    fn name(&self, text: &Spanned<String>) -> Result<Name, ConfigError> {
        let name = WrongText::or_name(text.get_ref());
        name.map_err(|error| self.error(&text.span(), error.into()))
    }

    fn address(&self, text: &Spanned<String>) -> Result<SocketAddr, ConfigError> {
        text.get_ref().parse().map_err(|_| {
            let error = ConfigValueError::Listen {
                text: text.get_ref().clone(),
            };
            self.error(&text.span(), error)
        })
    }

    fn peer(&self, table: &PeerTable) -> Result<PeerConfig, ConfigError> {
        let id = table.id.get_ref().parse();
        let id = id.map_err(|error| self.error(&table.id.span(), ConfigValueError::Id(error)))?;
        let addresses = table.addresses.iter().map(|text| {
            let address = text.get_ref().parse();
            address.map_err(|source| {
                let value = text.get_ref().clone();
                let error = ConfigValueError::Address {
                    text: value,
                    source,
                };
                self.error(&text.span(), error)
            })
        });
        Ok(PeerConfig {
            name: self.name(&table.name)?,
            id,
            addresses: addresses.collect::<Result<_, _>>()?,
        })
    }

    fn rule(
        &self,
        table: &RuleTable,
        ids: &BTreeMap<Name, GatewayId>,
    ) -> Result<(Rule, SendQos), ConfigError> {
        let names = WrongText::or_pattern(table.names.get_ref());
        let names = names.map_err(|error| self.error(&table.names.span(), error.into()))?;
        let known = |text: &Spanned<String>| {
            let id = Name::new(text.get_ref())
                .ok()
                .and_then(|it| ids.get(&it).copied());
            if id.is_none() && self.unknown_peers == UnknownPeers::Refused {
                let text_of_rule = text.get_ref().clone();
                let error = ConfigValueError::UnknownPeer { text: text_of_rule };
                return Err(self.error(&text.span(), error));
            }
            Ok(id)
        };
        let peers = table.peers.as_ref();
        let peers = peers.map(|it| {
            let ids = it.iter().map(known).collect::<Result<Vec<_>, _>>();
            ids.map(|it| it.into_iter().flatten().collect())
        });
        let priority = match &table.priority {
            Some(it) if *it.get_ref() > PRIORITY_MAX => {
                return Err(self.error(&it.span(), ConfigValueError::Priority));
            }
            Some(it) => *it.get_ref(),
            None => DEFAULT_SEND_QOS.priority,
        };
        let rule = Rule {
            action: table.action.into(),
            kind: table.kind.map(SubjectKind::from),
            names,
            direction: table.direction.into(),
            peers: peers.transpose()?,
        };
        let qos = SendQos {
            priority,
            messages_per_s: table.messages_per_s,
            bytes_per_s: table.bytes_per_s,
            max_age: table.max_age_ms.map(Duration::from_millis),
            ..DEFAULT_SEND_QOS
        };
        Ok((rule, qos))
    }
}
