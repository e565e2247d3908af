//! The configuration file: TOML, in which every key is known.

use std::{
    collections::BTreeMap,
    fs, io,
    net::SocketAddr,
    num::{NonZeroU32, NonZeroU64},
    ops::Range,
    path::{Path, PathBuf},
    time::Duration,
};

use serde::Deserialize;
use sm2_io::quic::Congestion;
use sm2_proto::{
    Name,
    gateway::{
        Action, Direction, GatewayId, Pattern, Rule, Rules, SubjectKind,
        schedule::{PRIORITY_MAX, Terms},
    },
};
use toml::Spanned;

use crate::{
    address::Address,
    domain::DomainLocation,
    hub::{DEFAULT_TERMS, Policy},
    peer::Limits,
    shadow::RuleSet,
};

/// Where a gateway listens if nothing else is said.
const LISTEN: &str = "[::]:7633";

/// A configuration that was checked.
#[derive(Clone, Debug)]
pub struct Config {
    /// Which file it is of.
    pub path: PathBuf,
    /// What people call this gateway.
    pub name: Name,
    /// Where QUIC listens.
    pub listen: SocketAddr,
    /// Where the key is.
    pub key: PathBuf,
    /// The domain that it connects to its peers.
    pub domain: DomainLocation,
    /// On which interfaces it sends and hears beacons.
    pub discovery: Vec<String>,
    /// How fast connections send.
    pub congestion: Congestion,
    /// How much is kept of a peer.
    pub limits: Limits,
    /// Who is trusted.
    pub peers: Vec<PeerConfig>,
    /// What goes where, and how.
    pub policy: Policy,
    /// The line of each rule.
    pub rule_lines: Vec<usize>,
}

/// A peer that is trusted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PeerConfig {
    /// What this file calls it.
    pub name: Name,
    /// Who it is.
    pub id: GatewayId,
    /// Where it may be.
    pub addresses: Vec<Address>,
}

/// Why a configuration is of no use.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Something in it is not as it should be.
    #[error("{path}:{line}: {what}")]
    Wrong {
        /// Which file.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong, and what would not be.
        what: String,
    },
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
    message_bytes: Option<u64>,
    memory_bytes: Option<u64>,
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

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ActionWord {
    Allow,
    Deny,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum KindWord {
    Topic,
    Service,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum DirectionWord {
    In,
    Out,
    #[default]
    Both,
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

    /// Checks a text; `path` is where paths in it start from.
    ///
    /// # Errors
    /// See [`ConfigError`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let at = At { path, text };
        let file: File = toml::from_str(text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            at.wrong(&span, error.message().to_owned())
        })?;
        let name = at.name(&file.name)?;
        let listen = match &file.listen {
            Some(listen) => at.address(listen)?,
            None => at.address(&Spanned::new(0..0, LISTEN.to_owned()))?,
        };
        let folder = path.parent().unwrap_or(Path::new(""));
        let domain = match (file.domain, file.socket) {
            (None, None) => DomainLocation::Environment,
            (Some(name), None) => DomainLocation::Name(name),
            (None, Some(socket)) => DomainLocation::Socket(folder.join(socket.into_inner())),
            (Some(_), Some(socket)) => {
                let what = "`domain` and `socket` exclude each other: remove one of them";
                return Err(at.wrong(&socket.span(), what.to_owned()));
            }
        };
        let mut peers = Vec::new();
        let mut ids = BTreeMap::new();
        for table in &file.peer {
            let peer = at.peer(table)?;
            if ids.insert(peer.name.clone(), peer.id).is_some() {
                let what = format!("there are two peers of the name {}", peer.name);
                return Err(at.wrong(&table.name.span(), what));
            }
            if let Some(twin) = peers.iter().find(|it: &&PeerConfig| it.id == peer.id) {
                let what = format!("this is the id of {} too", twin.name);
                return Err(at.wrong(&table.id.span(), what));
            }
            peers.push(peer);
        }
        let mut policy = Policy::default();
        let mut rule_lines = Vec::new();
        for table in &file.rule {
            let (rule, terms) = at.rule(table.get_ref(), &ids)?;
            policy.rules.0.push(rule);
            policy.terms.push(terms);
            rule_lines.push(at.line(&table.span()));
        }
        let default = Limits::default();
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
            limits: Limits {
                message_bytes: file.limits.message_bytes.unwrap_or(default.message_bytes),
                memory_bytes: file.limits.memory_bytes.unwrap_or(default.memory_bytes),
            },
            peers,
            policy,
            rule_lines,
        })
    }

    /// The peer of this name, or of this id.
    #[must_use]
    pub fn peer(&self, text: &str) -> Option<&PeerConfig> {
        let id = text.parse().ok();
        let is_it = |it: &&PeerConfig| it.name.as_str() == text || Some(it.id) == id;
        self.peers.iter().find(is_it)
    }

    /// The rules, and the peers that they are for.
    #[must_use]
    pub fn rule_set(&self) -> RuleSet {
        RuleSet {
            rules: self.policy.rules.clone(),
            peers: self.peers.iter().map(|it| it.id).collect(),
        }
    }

    /// The keys of the file that `new` has otherwise, and that only a gateway that is started anew takes.
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

    /// The rule that decides about a name, as it stands in the file; none: the answer is no.
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

/// Where something stands.
struct At<'a> {
    path: &'a Path,
    text: &'a str,
}

impl At<'_> {
    fn line(&self, span: &Range<usize>) -> usize {
        let before = self.text.get(..span.start).unwrap_or("");
        before.matches('\n').count() + 1
    }

    fn wrong(&self, span: &Range<usize>, what: String) -> ConfigError {
        ConfigError::Wrong {
            path: self.path.into(),
            line: self.line(span),
            what,
        }
    }

    fn name(&self, text: &Spanned<String>) -> Result<Name, ConfigError> {
        Name::new(text.get_ref())
            .map_err(|error| self.wrong(&text.span(), format!("`{}`: {error}", text.get_ref())))
    }

    fn address(&self, text: &Spanned<String>) -> Result<SocketAddr, ConfigError> {
        text.get_ref().parse().map_err(|_| {
            let what = format!(
                "`{}` is no address with a port, such as 192.0.2.1:7633 or [fe80::1%2]:7633",
                text.get_ref()
            );
            self.wrong(&text.span(), what)
        })
    }

    fn peer(&self, table: &PeerTable) -> Result<PeerConfig, ConfigError> {
        let id = table.id.get_ref().parse();
        let id = id.map_err(|error| {
            let what = format!("{error}; `sm2 gateway id` prints it at the peer");
            self.wrong(&table.id.span(), what)
        })?;
        let addresses = table.addresses.iter().map(|text| {
            let address = text.get_ref().parse();
            address
                .map_err(|error| self.wrong(&text.span(), format!("`{}` {error}", text.get_ref())))
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
    ) -> Result<(Rule, Terms), ConfigError> {
        let names = Pattern::new(table.names.get_ref());
        let names = names.map_err(|error| {
            self.wrong(
                &table.names.span(),
                format!("`{}`: {error}", table.names.get_ref()),
            )
        })?;
        let known = |text: &Spanned<String>| {
            let id = Name::new(text.get_ref())
                .ok()
                .and_then(|it| ids.get(&it).copied());
            id.ok_or_else(|| {
                let what = format!("no [[peer]] before this has the name `{}`", text.get_ref());
                self.wrong(&text.span(), what)
            })
        };
        let peers = table.peers.as_ref();
        let peers = peers.map(|it| it.iter().map(known).collect::<Result<Vec<_>, _>>());
        let priority = match &table.priority {
            Some(it) if *it.get_ref() > PRIORITY_MAX => {
                let what = format!("a priority is 0 to {PRIORITY_MAX}");
                return Err(self.wrong(&it.span(), what));
            }
            Some(it) => *it.get_ref(),
            None => DEFAULT_TERMS.priority,
        };
        let rule = Rule {
            action: match table.action {
                ActionWord::Allow => Action::Allow,
                ActionWord::Deny => Action::Deny,
            },
            kind: table.kind.map(|it| match it {
                KindWord::Topic => SubjectKind::Topic,
                KindWord::Service => SubjectKind::Service,
            }),
            names,
            direction: match table.direction {
                DirectionWord::In => Some(Direction::In),
                DirectionWord::Out => Some(Direction::Out),
                DirectionWord::Both => None,
            },
            peers: peers.transpose()?,
        };
        let terms = Terms {
            priority,
            messages_per_s: table.messages_per_s,
            bytes_per_s: table.bytes_per_s,
            max_age: table.max_age_ms.map(Duration::from_millis),
            ..DEFAULT_TERMS
        };
        Ok((rule, terms))
    }
}
