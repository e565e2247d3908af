//! The configuration of a bridge: TOML without unknown keys.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use sm2_bridge_core::config::{
    RuleTable, RuleTables, Source, SpoolConfig, SpoolTable, ValueError, read,
};
use sm2_gateway::DomainLocation;
use sm2_proto::Name;
use sm2_proto::gateway::{Direction, SubjectKind};
use toml::Spanned;

/// The default prefix of subjects.
const PREFIX: &str = "sm2";

/// The reason why a file is not a configuration of this bridge.
pub type ConfigError = sm2_bridge_core::config::ConfigError<ConfigValueError>;

/// A checked configuration.
#[derive(Clone, Debug)]
pub struct Config {
    /// The name of the bridge, which no other bridge of the stream has.
    pub name: Name,
    /// The domain.
    pub domain: DomainLocation,
    /// The start of all subjects: the topic `camera/image` has the subject `PREFIX.camera.image`.
    pub prefix: String,
    /// The servers, such as `nats://192.0.2.1:4222`.
    pub servers: Vec<String>,
    /// The stream, which the bridge makes if it is missing.
    pub stream: String,
    /// A file with credentials.
    pub credentials: Option<PathBuf>,
    /// The files of messages that the stream has not acknowledged.
    pub spool: SpoolConfig,
    /// The rules.
    pub rules: RuleTables,
}

/// The reason why a value of a configuration is wrong.
#[derive(Debug, thiserror::Error)]
pub enum ConfigValueError {
    /// A value that all bridges have is wrong.
    #[error(transparent)]
    Common(#[from] ValueError),
    /// A rule has a key without effect.
    #[error("`durable` has no effect: all topics that this bridge lets out are durable")]
    Durable,
    /// Services do not pass.
    #[error("this bridge carries topics only, not services")]
    Service,
    /// There is no server.
    #[error("`servers` names no server")]
    NoServer,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: Spanned<String>,
    domain: Option<String>,
    socket: Option<Spanned<PathBuf>>,
    prefix: Option<Spanned<String>>,
    nats: NatsTable,
    spool: Spanned<SpoolTable>,
    #[serde(default)]
    rule: Vec<Spanned<RuleTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NatsTable {
    servers: Spanned<Vec<String>>,
    stream: String,
    credentials: Option<PathBuf>,
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
        let at = Source { path, text };
        let file: File = at.tables()?;
        let nats = file.nats;
        if nats.servers.get_ref().is_empty() {
            return Err(at.error(&nats.servers.span(), ConfigValueError::NoServer));
        }
        let rules = at.rules(&file.rule, |table, rule| {
            match (table.durable(), rule.kind) {
                (Some(durable), _) => Err(at.error(&durable, ConfigValueError::Durable)),
                (None, Some(SubjectKind::Service)) => {
                    Err(at.error(&table.names(), ConfigValueError::Service))
                }
                _ => Ok(true),
            }
        })?;
        Ok(Self {
            name: at.name(&file.name)?,
            domain: at.domain(file.domain, file.socket)?,
            prefix: at.prefix(file.prefix.as_ref(), PREFIX)?.replace('/', "."),
            servers: nats.servers.into_inner(),
            stream: nats.stream,
            credentials: nats.credentials.map(|it| at.folder().join(it)),
            spool: at.spool(&file.spool)?,
            rules,
        })
    }

    /// Whether a topic may pass.
    pub(crate) fn allows(&self, topic: &Name, direction: Direction) -> bool {
        self.rules
            .explain(SubjectKind::Topic, topic, direction)
            .is_allowed
    }
}
