//! The configuration of a bridge: TOML without unknown keys.

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use sm2_bridge_core::config::{
    Decision, RuleTable, RuleTables, Source, SpoolConfig, SpoolTable, ValueError, read,
};
use sm2_gateway::DomainLocation;
use sm2_proto::Name;
use sm2_proto::gateway::{Action, Direction, Rule, SubjectKind};
use toml::Spanned;

/// The default prefix of key expressions.
const PREFIX: &str = "sm2";
/// The largest number of a ROS domain.
const ROS_DOMAIN_MAX: u8 = 232;

/// The reason why a file is not a configuration of this bridge.
pub type ConfigError = sm2_bridge_core::config::ConfigError<ConfigValueError>;

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
    /// The rules.
    pub rules: RuleTables,
    /// The files of durable topics.
    pub spool: Option<SpoolConfig>,
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

/// The reason why a value of a configuration is wrong.
#[derive(Debug, thiserror::Error)]
pub enum ConfigValueError {
    /// A value that all bridges have is wrong.
    #[error(transparent)]
    Common(#[from] ValueError),
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
    /// A durable topic needs a folder.
    #[error("a durable topic needs a table `[spool]` with a `folder` for its messages")]
    NoSpool,
    /// A rule cannot make anything durable.
    #[error("`durable` needs mode `plain` and a rule that allows topics with direction `out`")]
    Durable,
    /// Zenoh refuses a value.
    #[error("Zenoh refuses `{key}`: {message}")]
    Zenoh {
        /// The key in Zenoh's configuration.
        key: &'static str,
        /// The reason, in the words of Zenoh.
        message: String,
    },
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
    spool: Option<Spanned<SpoolTable>>,
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

impl Config {
    /// Reads and checks a file.
    ///
    /// # Errors
    ///
    /// See [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::parse(path, &read(path)?)
    }

    /// Checks the text of a file. Relative paths in it start at the folder of `path`.
    ///
    /// # Errors
    ///
    /// See [`ConfigError`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let at = Reader(Source { path, text });
        let file: File = at.0.tables()?;
        let mode = at.mode(&file)?;
        let has_spool = file.spool.is_some();
        Ok(Self {
            name: at.0.name(&file.name)?,
            domain: at.0.domain(file.domain, file.socket)?,
            zenoh: at.zenoh(&file.zenoh)?,
            rules: (at.0).rules(&file.rule, |table, rule| {
                at.is_durable(table, rule, &mode, has_spool)
            })?,
            spool: file.spool.map(|it| at.0.spool(&it)).transpose()?,
            mode,
        })
    }

    /// The decision about a topic or service, and the line of the rule that makes it.
    #[must_use]
    pub fn explain(&self, kind: SubjectKind, name: &Name, direction: Direction) -> Decision {
        self.rules.explain(kind, name, direction)
    }

    /// Whether a service may pass. `Out` offers a service of the domain to the network.
    pub(crate) fn allows_service(&self, service: &Name, direction: Direction) -> bool {
        self.explain(SubjectKind::Service, service, direction)
            .is_allowed
    }

    /// Whether a topic that goes out is durable.
    pub(crate) fn is_durable(&self, topic: &Name) -> bool {
        self.explain(SubjectKind::Topic, topic, Direction::Out)
            .is_durable
    }

    /// Whether a topic may pass.
    pub(crate) fn allows(&self, topic: &Name, direction: Direction) -> bool {
        self.explain(SubjectKind::Topic, topic, direction)
            .is_allowed
    }
}

/// Reads the tables of a file.
struct Reader<'a>(Source<'a>);

impl Reader<'_> {
    fn error(&self, span: &Range<usize>, source: ConfigValueError) -> ConfigError {
        self.0.error(span, source)
    }

    fn mode(&self, file: &File) -> Result<Mode, ConfigError> {
        match file.mode {
            ModeWord::Plain => {
                self.unused("ros_domain_id", "plain", file.ros_domain_id.as_ref())?;
                let prefix = self.0.prefix(file.prefix.as_ref(), PREFIX)?;
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

    fn is_durable(
        &self,
        table: &RuleTable,
        rule: &Rule,
        mode: &Mode,
        has_spool: bool,
    ) -> Result<bool, ConfigError> {
        let Some(durable) = table.durable() else {
            return Ok(false);
        };
        let is_out = rule.direction != Some(Direction::In);
        let is_topic = rule.kind != Some(SubjectKind::Service);
        let error = match mode {
            Mode::Plain { .. } if rule.action == Action::Allow && is_out && is_topic => {
                match has_spool {
                    true => return Ok(true),
                    false => ConfigValueError::NoSpool,
                }
            }
            _ => ConfigValueError::Durable,
        };
        Err(self.error(&durable, error))
    }

    fn zenoh(&self, table: &Spanned<ZenohTable>) -> Result<zenoh::Config, ConfigError> {
        let refused = |key: &'static str, message: String| {
            let error = ConfigValueError::Zenoh { key, message };
            self.error(&table.span(), error)
        };
        let its = table.get_ref();
        let mut config = match &its.file {
            Some(file) => zenoh::Config::from_file(self.0.folder().join(file))
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
