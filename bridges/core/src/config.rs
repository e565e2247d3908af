//! The common parts of the configurations of all bridges: TOML without unknown keys, and errors with lines.

use std::fs;
use std::io;
use std::num::{NonZeroU32, NonZeroU64};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use sm2_gateway::DomainLocation;
use sm2_gateway::hub::DEFAULT_SEND_QOS;
use sm2_gateway::rule_words::{ActionWord, DirectionWord, KindWord};
use sm2_proto::gateway::schedule::{PRIORITY_MAX, SendQos};
use sm2_proto::gateway::{
    Action, Direction, GatewayId, Pattern, PatternError, Rule, Rules, SubjectKind,
};
use sm2_proto::{Name, NameError};
use toml::Spanned;

use crate::spool::{Limits, LimitsError};

/// The default limits of a spool.
const SPOOL_MAX_BYTES: u64 = 256 << 20;
const WINDOW_BYTES: u64 = 1 << 20;
/// All of a network are one peer.
pub(crate) const NETWORK: GatewayId = GatewayId([0; 32]);

/// The reason why a file is not a configuration. `E` has the reasons why a value of this bridge is wrong.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError<E: std::error::Error> {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The reason.
        r#source: io::Error,
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
        r#source: E,
    },
}

/// The reason why a value that all bridges have is wrong.
#[derive(Debug, thiserror::Error)]
pub enum ValueError {
    /// A name is wrong.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A pattern of names is wrong.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// The prefix is not a name.
    #[error("the prefix is not a name: {0}")]
    Prefix(NameError),
    /// The limits of the spool contradict each other.
    #[error(transparent)]
    Spool(#[from] LimitsError),
    /// Both `domain` and `socket` are given.
    #[error("`domain` and `socket` exclude each other")]
    DomainAndSocket,
    /// The priority of a rule is too great.
    #[error("a priority is 0 to {PRIORITY_MAX}")]
    Priority,
    /// The spool, not the rule, says when durable messages are sent.
    #[error(
        "`priority`, `messages_per_s`, `bytes_per_s` and `max_age_ms` have no effect on durable topics: \
         the table `[spool]` has `rate_bytes_per_s` and `max_age_s`"
    )]
    DurableBudget,
}

/// The rules of a configuration, and what the file says of each of them.
#[derive(Clone, Debug, Default)]
pub struct RuleTables {
    /// The rules, in their order.
    pub rules: Rules,
    /// A note for each rule.
    pub notes: Vec<RuleNote>,
}

/// The line of a rule, and its options beside those of [`Rule`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RuleNote {
    /// Its line in the file.
    pub line: usize,
    /// Whether the topics that it lets out are durable.
    pub is_durable: bool,
    /// How the messages of the topics that it lets out are sent.
    pub budget: Budget,
}

/// How messages of a topic are sent to the network, by the words of the gateway's rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// 0 to 7: each step doubles the share of a topic while several have messages that wait.
    pub priority: u8,
    /// The greatest rate of messages.
    pub messages_per_s: Option<NonZeroU32>,
    /// The greatest rate of bytes, averaged over messages.
    pub bytes_per_s: Option<NonZeroU64>,
    /// The greatest age, since publication, of a message that the network can take.
    pub max_age: Option<Duration>,
}

impl Default for Budget {
    fn default() -> Self {
        let SendQos {
            priority,
            messages_per_s,
            bytes_per_s,
            max_age,
            ..
        } = DEFAULT_SEND_QOS;
        Self {
            priority,
            messages_per_s,
            bytes_per_s,
            max_age,
        }
    }
}

impl Budget {
    /// The same for a scheduler that lets at most `depth` messages of the topic wait.
    #[must_use]
    pub const fn send_qos(&self, depth: u16) -> SendQos {
        SendQos {
            depth,
            priority: self.priority,
            messages_per_s: self.messages_per_s,
            bytes_per_s: self.bytes_per_s,
            max_age: self.max_age,
        }
    }
}

/// The decision of the rules about a topic or service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Decision {
    /// Whether it may pass.
    pub is_allowed: bool,
    /// The line of the rule that decides; `None` if no rule matches, which denies.
    pub line: Option<usize>,
    /// Whether the topic is durable.
    pub is_durable: bool,
    /// How messages that go out are sent.
    pub budget: Budget,
}

/// The files of durable topics.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpoolConfig {
    /// The folder, which no other bridge uses.
    pub folder: PathBuf,
    /// The limits of the messages in it.
    pub limits: Limits,
}

/// The table `[spool]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpoolTable {
    folder: PathBuf,
    max_bytes: Option<u64>,
    window_bytes: Option<u64>,
    max_age_s: Option<u64>,
    rate_bytes_per_s: Option<u64>,
}

/// A table `[[rule]]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RuleTable {
    action: ActionWord,
    kind: Option<KindWord>,
    names: Spanned<String>,
    #[serde(default)]
    direction: DirectionWord,
    durable: Option<Spanned<bool>>,
    priority: Option<Spanned<u8>>,
    messages_per_s: Option<NonZeroU32>,
    bytes_per_s: Option<NonZeroU64>,
    max_age_ms: Option<u64>,
}

impl RuleTable {
    /// The budget. `None` if the rule has none of its keys.
    fn budget(&self) -> Option<Budget> {
        let (messages_per_s, bytes_per_s) = (self.messages_per_s, self.bytes_per_s);
        let priority = self.priority.as_ref().map(|it| *it.get_ref());
        let max_age = self.max_age_ms.map(Duration::from_millis);
        let has_one = priority.is_some()
            || messages_per_s.is_some()
            || bytes_per_s.is_some()
            || max_age.is_some();
        has_one.then(|| Budget {
            priority: priority.unwrap_or(Budget::default().priority),
            messages_per_s,
            bytes_per_s,
            max_age,
        })
    }

    /// The place of `names`.
    #[must_use]
    pub fn names(&self) -> Range<usize> {
        self.names.span()
    }

    /// The place of `durable = true`.
    #[must_use]
    pub fn durable(&self) -> Option<Range<usize>> {
        let durable = self.durable.as_ref().filter(|it| *it.get_ref());
        durable.map(Spanned::span)
    }
}

impl RuleTables {
    /// The decision about a topic or service, and the line of the rule that makes it.
    #[must_use]
    pub fn explain(&self, kind: SubjectKind, name: &Name, direction: Direction) -> Decision {
        let decision = self.rules.decide(kind, name, direction, &NETWORK);
        let note = decision.rule.and_then(|it| self.notes.get(it));
        Decision {
            is_allowed: decision.action == Action::Allow,
            line: note.map(|it| it.line),
            is_durable: direction == Direction::Out && note.is_some_and(|it| it.is_durable),
            budget: note.map(|it| it.budget).unwrap_or_default(),
        }
    }

    /// Whether a rule lets topics or services into the domain.
    #[must_use]
    pub fn lets_in(&self) -> bool {
        let mut rules = self.rules.0.iter();
        rules.any(|it| it.action == Action::Allow && it.direction != Some(Direction::Out))
    }
}

/// The text of a configuration, which turns positions into lines.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// The file.
    pub path: &'a Path,
    /// Its text.
    pub text: &'a str,
}

/// Reads the text of a file.
///
/// # Errors
///
/// The file cannot be read.
pub fn read<E: std::error::Error>(path: &Path) -> Result<String, ConfigError<E>> {
    fs::read_to_string(path).map_err(|source| ConfigError::Io {
        path: path.to_owned(),
        source,
    })
}

impl Source<'_> {
    /// The folder where relative paths of the file begin.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// The tables of the file.
    ///
    /// # Errors
    ///
    /// The text is not TOML, or has an unknown key.
    pub fn tables<T, E>(&self) -> Result<T, ConfigError<E>>
    where
        T: DeserializeOwned,
        E: std::error::Error,
    {
        toml::from_str(self.text).map_err(|error| ConfigError::Toml {
            path: self.path.to_owned(),
            line: self.line(&error.span().unwrap_or_default()),
            message: error.message().to_owned(),
        })
    }

    /// The line of a place in the text, counted from 1.
    #[must_use]
    pub fn line(&self, span: &Range<usize>) -> usize {
        let before = self.text.get(..span.start).unwrap_or("");
        before.matches('\n').count() + 1
    }

    /// A value at this place is wrong.
    pub fn error<E: std::error::Error>(
        &self,
        span: &Range<usize>,
        source: impl Into<E>,
    ) -> ConfigError<E> {
        ConfigError::Value {
            path: self.path.to_owned(),
            line: self.line(span),
            source: source.into(),
        }
    }

    /// A name.
    ///
    /// # Errors
    ///
    /// The text is not a name.
    pub fn name<E>(&self, text: &Spanned<String>) -> Result<Name, ConfigError<E>>
    where
        E: std::error::Error + From<ValueError>,
    {
        let name = Name::new(text.get_ref()).map_err(ValueError::from);
        name.map_err(|error| self.error(&text.span(), error))
    }

    /// The start of all names in the network: `default` without a text.
    ///
    /// # Errors
    ///
    /// The text is not a name.
    pub fn prefix<E>(
        &self,
        text: Option<&Spanned<String>>,
        default: &str,
    ) -> Result<String, ConfigError<E>>
    where
        E: std::error::Error + From<ValueError>,
    {
        let Some(text) = text else {
            return Ok(default.to_owned());
        };
        let name = Name::new(text.get_ref()).map_err(ValueError::Prefix);
        let name = name.map_err(|error| self.error(&text.span(), error))?;
        Ok(name.to_string())
    }

    /// The domain, by its name or its socket.
    ///
    /// # Errors
    ///
    /// Both are given.
    pub fn domain<E>(
        &self,
        name: Option<String>,
        socket: Option<Spanned<PathBuf>>,
    ) -> Result<DomainLocation, ConfigError<E>>
    where
        E: std::error::Error + From<ValueError>,
    {
        match (name, socket) {
            (None, None) => Ok(DomainLocation::Environment),
            (Some(name), None) => Ok(DomainLocation::Name(name)),
            (None, Some(socket)) => {
                let socket = self.folder().join(socket.into_inner());
                Ok(DomainLocation::Socket(socket))
            }
            (Some(_), Some(socket)) => Err(self.error(&socket.span(), ValueError::DomainAndSocket)),
        }
    }

    /// The rules. `is_durable` decides about each of them.
    ///
    /// # Errors
    ///
    /// A pattern is wrong, or `is_durable` refuses a rule.
    pub fn rules<E>(
        &self,
        tables: &[Spanned<RuleTable>],
        is_durable: impl Fn(&RuleTable, &Rule) -> Result<bool, ConfigError<E>>,
    ) -> Result<RuleTables, ConfigError<E>>
    where
        E: std::error::Error + From<ValueError>,
    {
        let mut all = RuleTables::default();
        for spanned in tables {
            let table = spanned.get_ref();
            let names = Pattern::new(table.names.get_ref()).map_err(ValueError::from);
            let rule = Rule {
                action: table.action.into(),
                kind: table.kind.map(SubjectKind::from),
                names: names.map_err(|error| self.error(&table.names.span(), error))?,
                direction: table.direction.into(),
                peers: None,
            };
            let note = RuleNote {
                line: self.line(&spanned.span()),
                is_durable: is_durable(table, &rule)?,
                budget: table.budget().unwrap_or_default(),
            };
            if note.is_durable && table.budget().is_some() {
                return Err(self.error(&spanned.span(), ValueError::DurableBudget));
            }
            if let Some(it) = table
                .priority
                .as_ref()
                .filter(|it| *it.get_ref() > PRIORITY_MAX)
            {
                return Err(self.error(&it.span(), ValueError::Priority));
            }
            all.notes.push(note);
            all.rules.0.push(rule);
        }
        Ok(all)
    }

    /// The spool.
    ///
    /// # Errors
    ///
    /// Its limits contradict each other.
    pub fn spool<E>(&self, table: &Spanned<SpoolTable>) -> Result<SpoolConfig, ConfigError<E>>
    where
        E: std::error::Error + From<ValueError>,
    {
        let limits = table.get_ref().limits().map_err(ValueError::from);
        Ok(SpoolConfig {
            folder: self.folder().join(&table.get_ref().folder),
            limits: limits.map_err(|error| self.error(&table.span(), error))?,
        })
    }
}

impl SpoolTable {
    fn limits(&self) -> Result<Limits, LimitsError> {
        let max_bytes = self.max_bytes.unwrap_or(SPOOL_MAX_BYTES);
        let window_bytes = self.window_bytes.unwrap_or(WINDOW_BYTES.min(max_bytes));
        let mut limits = Limits::new(max_bytes, window_bytes)?;
        if let Some(seconds) = self.max_age_s {
            limits = limits.with_max_age(Duration::from_secs(seconds));
        }
        if let Some(rate) = self.rate_bytes_per_s {
            limits = limits.with_rate(rate)?;
        }
        Ok(limits)
    }
}
