//! The configuration of a bridge: TOML without unknown keys.

use std::fs;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use sm2_gateway::DomainLocation;
use sm2_gateway::rule_words::{ActionWord, DirectionWord, KindWord};
use sm2_proto::gateway::{
    Action, Direction, GatewayId, Pattern, PatternError, Rule, Rules, SubjectKind,
};
use sm2_proto::{Name, NameError};
use toml::Spanned;

/// The default prefix of key expressions.
const PREFIX: &str = "sm2";
/// The largest number of a ROS domain.
const ROS_DOMAIN_MAX: u8 = 232;
/// All of a Zenoh network are one peer.
const NETWORK: GatewayId = GatewayId([0; 32]);

/// A checked configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// The name of the bridge, which no other bridge of the network has.
    pub name: Name,
    /// The domain.
    pub domain: DomainLocation,
    /// The form of topics and types in the network.
    pub mode: Mode,
    /// The configuration of the Zenoh session.
    pub zenoh: zenoh::Config,
    /// The rules, in their order.
    pub rules: Rules,
    /// The line of each rule in the file.
    pub rule_lines: Vec<usize>,
}

/// The form of topics and types in the network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The names of the domain, below a prefix.
    Plain {
        /// The start of the key expressions of all topics.
        prefix: String,
    },
    /// That of rmw_zenoh. Only topics with types of ROS 2 pass.
    Ros2 {
        /// The number of the ROS domain (`ROS_DOMAIN_ID`).
        domain_id: u8,
    },
}

/// The reason why a file is no configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: io::Error,
    },
    /// The file is not TOML, or has an unknown key.
    #[error("{}:{line}: {message}", path.display())]
    Toml {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1.
        line: usize,
        /// The reason.
        message: String,
    },
    /// A value is wrong.
    #[error("{}:{line}: {source}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1.
        line: usize,
        /// The reason.
        source: ConfigValueError,
    },
}

/// The reason why a value of a configuration is wrong.
#[derive(Debug, thiserror::Error)]
pub enum ConfigValueError {
    /// A name is wrong.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A pattern of names is wrong.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// The prefix is no name.
    #[error("the prefix is not a name: {0}")]
    Prefix(NameError),
    /// The bridge is a node of ROS 2, whose names have fewer characters.
    #[error("in mode `ros2` the name begins with a letter, and holds only A-Z a-z 0-9 _")]
    RosName,
    /// The number of the ROS domain is too large.
    #[error("`ros_domain_id` is at most {ROS_DOMAIN_MAX}")]
    RosDomain,
    /// A key has no effect in this mode.
    #[error("`{key}` has no effect in mode `{mode}`")]
    WrongMode {
        /// The key.
        key: &'static str,
        /// The mode.
        mode: &'static str,
    },
    /// Both `domain` and `socket` are given.
    #[error("`domain` and `socket` exclude each other")]
    DomainAndSocket,
    /// Zenoh refuses a value.
    #[error("Zenoh refuses `{key}`: {message}")]
    Zenoh {
        /// The key in Zenoh's configuration.
        key: &'static str,
        /// The reason, in the words of Zenoh.
        message: String,
    },
}

/// The decision of the rules about a topic or service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Decision {
    /// Whether it may pass.
    pub is_allowed: bool,
    /// The line of the rule that decides; `None` if no rule matches, which denies.
    pub line: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: Spanned<String>,
    domain: Option<String>,
    socket: Option<Spanned<PathBuf>>,
    #[serde(default)]
    mode: ModeWord,
    prefix: Option<Spanned<String>>,
    ros_domain_id: Option<Spanned<u8>>,
    zenoh: Spanned<ZenohTable>,
    #[serde(default)]
    rule: Vec<Spanned<RuleTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ZenohTable {
    /// A file with Zenoh's own configuration: TLS, authentication and the like.
    file: Option<PathBuf>,
    mode: Option<SessionWord>,
    #[serde(default)]
    connect: Vec<String>,
    #[serde(default)]
    listen: Vec<String>,
    #[serde(default)]
    scouting: bool,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ModeWord {
    #[default]
    Plain,
    Ros2,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum SessionWord {
    Client,
    Peer,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RuleTable {
    action: ActionWord,
    kind: Option<KindWord>,
    names: Spanned<String>,
    #[serde(default)]
    direction: DirectionWord,
}

impl Config {
    /// Reads and checks a file.
    ///
    /// # Errors
    ///
    /// See [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = fs::read_to_string(path).map_err(|source| ConfigError::Io {
            path: path.to_owned(),
            source,
        })?;
        Self::parse(path, &text)
    }

    /// Checks the text of a file. Relative paths in it start at the folder of `path`.
    ///
    /// # Errors
    ///
    /// See [`ConfigError`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let at = Source { path, text };
        let file: File = toml::from_str(text).map_err(|error| ConfigError::Toml {
            path: path.to_owned(),
            line: at.line(&error.span().unwrap_or_default()),
            message: error.message().to_owned(),
        })?;
        let mode = at.mode(&file)?;
        let domain = match (file.domain, file.socket) {
            (None, None) => DomainLocation::Environment,
            (Some(name), None) => DomainLocation::Name(name),
            (None, Some(socket)) => DomainLocation::Socket(at.folder().join(socket.into_inner())),
            (Some(_), Some(socket)) => {
                return Err(at.error(&socket.span(), ConfigValueError::DomainAndSocket));
            }
        };
        let mut rules = Rules::default();
        let mut rule_lines = Vec::new();
        for table in &file.rule {
            rules.0.push(at.rule(table.get_ref())?);
            rule_lines.push(at.line(&table.span()));
        }
        let name = Name::new(file.name.get_ref());
        Ok(Self {
            name: name.map_err(|error| at.error(&file.name.span(), error.into()))?,
            domain,
            mode,
            zenoh: at.zenoh(&file.zenoh)?,
            rules,
            rule_lines,
        })
    }

    /// The decision about a topic or service, and the line of the rule that makes it.
    #[must_use]
    pub fn explain(&self, kind: SubjectKind, name: &Name, direction: Direction) -> Decision {
        let decision = self.rules.decide(kind, name, direction, &NETWORK);
        let line = decision.rule.and_then(|it| self.rule_lines.get(it));
        Decision {
            is_allowed: decision.action == Action::Allow,
            line: line.copied(),
        }
    }

    /// Whether a service may pass. `Out` offers a service of the domain to the network.
    pub(crate) fn allows_service(&self, service: &Name, direction: Direction) -> bool {
        self.explain(SubjectKind::Service, service, direction)
            .is_allowed
    }

    /// Whether a topic may pass.
    pub(crate) fn allows(&self, topic: &Name, direction: Direction) -> bool {
        self.explain(SubjectKind::Topic, topic, direction)
            .is_allowed
    }
}

/// The text of a configuration, to turn positions into lines.
struct Source<'a> {
    path: &'a Path,
    text: &'a str,
}

impl Source<'_> {
    fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    fn line(&self, span: &Range<usize>) -> usize {
        let before = self.text.get(..span.start).unwrap_or("");
        before.matches('\n').count() + 1
    }

    fn error(&self, span: &Range<usize>, source: ConfigValueError) -> ConfigError {
        ConfigError::Value {
            path: self.path.to_owned(),
            line: self.line(span),
            source,
        }
    }

    fn mode(&self, file: &File) -> Result<Mode, ConfigError> {
        match file.mode {
            ModeWord::Plain => {
                self.unused("ros_domain_id", "plain", file.ros_domain_id.as_ref())?;
                let Some(prefix) = &file.prefix else {
                    let prefix = PREFIX.to_owned();
                    return Ok(Mode::Plain { prefix });
                };
                let name = Name::new(prefix.get_ref()).map_err(ConfigValueError::Prefix);
                let name = name.map_err(|error| self.error(&prefix.span(), error))?;
                let prefix = name.to_string();
                Ok(Mode::Plain { prefix })
            }
            ModeWord::Ros2 => {
                self.unused("prefix", "ros2", file.prefix.as_ref())?;
                if !is_ros_name(file.name.get_ref()) {
                    return Err(self.error(&file.name.span(), ConfigValueError::RosName));
                }
                let domain_id = file.ros_domain_id.as_ref();
                if let Some(it) = domain_id.filter(|it| *it.get_ref() > ROS_DOMAIN_MAX) {
                    return Err(self.error(&it.span(), ConfigValueError::RosDomain));
                }
                let domain_id = domain_id.map_or(0, |it| *it.get_ref());
                Ok(Mode::Ros2 { domain_id })
            }
        }
    }

    /// Refuses a key that has no effect in a mode.
    fn unused<T>(
        &self,
        key: &'static str,
        mode: &'static str,
        value: Option<&Spanned<T>>,
    ) -> Result<(), ConfigError> {
        value.map_or(Ok(()), |value| {
            let error = ConfigValueError::WrongMode { key, mode };
            Err(self.error(&value.span(), error))
        })
    }

    fn rule(&self, table: &RuleTable) -> Result<Rule, ConfigError> {
        let names = Pattern::new(table.names.get_ref());
        Ok(Rule {
            action: table.action.into(),
            kind: table.kind.map(SubjectKind::from),
            names: names.map_err(|error| self.error(&table.names.span(), error.into()))?,
            direction: table.direction.into(),
            peers: None,
        })
    }

    fn zenoh(&self, table: &Spanned<ZenohTable>) -> Result<zenoh::Config, ConfigError> {
        let refused = |key: &'static str, message: String| {
            let error = ConfigValueError::Zenoh { key, message };
            self.error(&table.span(), error)
        };
        let its = table.get_ref();
        let mut config = match &its.file {
            Some(file) => zenoh::Config::from_file(self.folder().join(file))
                .map_err(|error| refused("file", error.to_string()))?,
            None => zenoh::Config::default(),
        };
        let mut set = |key: &'static str, value: String| {
            let inserted = config.insert_json5(key, &value);
            inserted.map_err(|error| refused(key, error.to_string()))
        };
        if let Some(mode) = its.mode {
            let word = match mode {
                SessionWord::Client => "\"client\"",
                SessionWord::Peer => "\"peer\"",
            };
            set("mode", word.to_owned())?;
        }
        // Rust's notation of a list of texts is one of JSON5.
        if !its.connect.is_empty() {
            set("connect/endpoints", format!("{:?}", its.connect))?;
        }
        if !its.listen.is_empty() {
            set("listen/endpoints", format!("{:?}", its.listen))?;
        }
        if its.file.is_none() {
            set("scouting/multicast/enabled", its.scouting.to_string())?;
        }
        Ok(config)
    }
}

/// Whether a name is one of a node of ROS 2.
fn is_ros_name(text: &str) -> bool {
    let is_legal = |it: u8| it.is_ascii_alphanumeric() || it == b'_';
    text.starts_with(|it: char| it.is_ascii_alphabetic()) && text.bytes().all(is_legal)
}
