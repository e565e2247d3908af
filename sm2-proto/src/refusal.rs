//! The reasons why a legal request is not granted. The session goes on.

use serde::{Deserialize, Serialize};

use crate::{Name, TypeId, control::Limit};

/// The Manager's reason for not granting HELLO or DECLARE.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, thiserror::Error)]
pub enum Refusal {
    /// Another node of the domain has this name.
    #[error("another node of this domain has that name: choose another one or stop that node")]
    NameTaken,
    /// The Manager speaks none of the versions that the node named.
    #[error("the Manager speaks protocol versions {min} to {max} only: update the older side")]
    Version {
        /// The oldest version that the Manager speaks.
        min: u16,
        /// The newest version that the Manager speaks.
        max: u16,
    },
    /// The topic carries another type.
    #[error("the topic carries messages of type {theirs}")]
    TopicType {
        /// The type in use.
        theirs: TypeId,
    },
    /// The service has other types.
    #[error("the service takes {request} and replies {reply}")]
    ServiceType {
        /// The type of requests in use.
        request: TypeId,
        /// The type of replies in use.
        reply: TypeId,
    },
    /// A quota is used up.
    #[error("the quota of {limit} {quota} is used up: close some{}", quota.remedy())]
    Quota {
        /// The quota.
        quota: Quota,
        /// The limit that the quota sets.
        limit: u32,
    },
    /// The access policy of the domain denies the request.
    #[error("{}", Denial(.rule.as_ref()))]
    Denied {
        /// The name of the rule or binding that denies; `None` for the default of the policy.
        rule: Option<Name>,
    },
    /// The topic may have one publisher only, and there is one.
    #[error(
        "the topic has a publisher already, and `{rule}` of the access policy allows one only: stop that \
         one first"
    )]
    Exclusive {
        /// The name of the exclusive entry of the policy.
        rule: Name,
    },
}

impl Refusal {
    /// Whether the access policy of the domain is the reason.
    #[must_use]
    pub const fn is_denial(&self) -> bool {
        matches!(self, Self::Denied { .. } | Self::Exclusive { .. })
    }
}

/// The text of a denial.
struct Denial<'a>(Option<&'a Name>);

impl core::fmt::Display for Denial<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            Some(rule) => write!(f, "`{rule}` of the access policy denies it")?,
            None => f.write_str("the access policy denies it, as no rule allows it")?,
        }
        f.write_str(": have the operator change the policy (see `sm2 policy explain`)")
    }
}

/// The objects that a quota counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Quota {
    /// Ready sessions of one user.
    SessionsPerUser,
    /// Interfaces of one session.
    InterfacesPerSession,
    /// Interfaces of all sessions of one user.
    InterfacesPerUser,
    /// Links of one session.
    LinksPerSession,
    /// Ready sessions of one process.
    SessionsPerProcess,
    /// Interfaces of all sessions of one process.
    InterfacesPerProcess,
}

impl Quota {
    /// Every quota.
    pub const ALL: [Self; 6] = [
        Self::SessionsPerUser,
        Self::InterfacesPerSession,
        Self::InterfacesPerUser,
        Self::LinksPerSession,
        Self::SessionsPerProcess,
        Self::InterfacesPerProcess,
    ];

    /// The limit of a Manager that sets the quota.
    #[must_use]
    pub const fn limit(self) -> Limit {
        match self {
            Self::SessionsPerUser => Limit::SessionsPerUser,
            Self::InterfacesPerSession => Limit::InterfacesPerSession,
            Self::InterfacesPerUser => Limit::InterfacesPerUser,
            Self::LinksPerSession => Limit::LinksPerSession,
            Self::SessionsPerProcess => Limit::SessionsPerProcess,
            Self::InterfacesPerProcess => Limit::InterfacesPerProcess,
        }
    }

    /// How to raise the quota: the end of a sentence that names another remedy first.
    #[must_use]
    pub fn remedy(self) -> impl core::fmt::Display {
        Remedy(self)
    }
}

/// How to raise a quota.
struct Remedy(Quota);

impl core::fmt::Display for Remedy {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let name = self.0.limit().name();
        write!(f, ", or have the operator raise {name} of the Manager")
    }
}

/// `sessions per user`
impl core::fmt::Display for Quota {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let words = self.limit().name().split('_');
        for (at, word) in words.enumerate() {
            let blank = if at == 0 { "" } else { " " };
            write!(f, "{blank}{word}")?;
        }
        Ok(())
    }
}
