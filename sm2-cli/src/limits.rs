//! The limits in force at the Manager, and how much of them is used.

use clap::Args;
use serde::{Serialize, Serializer, ser::SerializeMap as _};
use sm2_node::explain::{processes, sessions, users};
use sm2_proto::control::{Limit, StatedLimit, StatedLimits};

use crate::{
    columns::{Column, Row, cell},
    view::View,
};

/// The limits that the Manager states. In JSON they are an object, with the two flags about seals behind them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LimitsInForce(pub(crate) StatedLimits);

impl Serialize for LimitsInForce {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut object = serializer.serialize_map(None)?;
        for limit in &self.0.limits {
            object.serialize_entry(&limit.name, &limit.value)?;
        }
        object.serialize_entry("seal_all", &self.0.seal_all)?;
        object.serialize_entry("waive_user_boundary", &self.0.waive_user_boundary)?;
        object.end()
    }
}

/// The use of a limit by a user, a process or a node.
#[derive(Clone, Serialize)]
pub(crate) struct Quota {
    /// The owner of the quota: `user 1000` or `node talker`.
    pub(crate) of: String,
    /// The kind of thing that is counted.
    pub(crate) quota: &'static str,
    pub(crate) used: u32,
    pub(crate) limit: u32,
    #[serde(skip)]
    pub(crate) kind: Limit,
}

impl Row for Quota {
    const COLUMNS: &'static [Column<Self>] = &[
        ("QUOTA OF", |it| it.of.clone()),
        ("WHAT", |it| it.quota.to_owned()),
        ("USED", |it| it.used.to_string()),
        ("LIMIT", |it| it.limit.to_string()),
    ];
}

impl Quota {
    /// Whether the limit is [near](NEAR_PERCENT).
    pub(crate) fn is_near(&self) -> bool {
        u64::from(self.used) * 100 >= u64::from(self.limit) * NEAR_PERCENT
    }
}

/// The use of each limit whose use is visible and that the Manager states. Empty if the limits are not known.
pub(crate) fn quotas(view: &View<'_>) -> Vec<Quota> {
    let Some(limits) = view.domain.limits() else {
        return Vec::new();
    };
    let mut quotas = Vec::new();
    let mut add = |of: &str, quota, used, kind| {
        quotas.extend(limits.of(kind).map(|limit| Quota {
            of: of.to_owned(),
            quota,
            used,
            limit,
            kind,
        }));
    };
    for (uid, usage) in users(view.domain) {
        let of = format!("user {uid}");
        add(&of, "sessions", usage.sessions, Limit::SessionsPerUser);
        add(
            &of,
            "interfaces",
            usage.interfaces,
            Limit::InterfacesPerUser,
        );
    }
    for ((_, pid), usage) in processes(view.domain) {
        let of = format!("process {pid}");
        add(&of, "sessions", usage.sessions, Limit::SessionsPerProcess);
        add(
            &of,
            "interfaces",
            usage.interfaces,
            Limit::InterfacesPerProcess,
        );
    }
    for (node, usage) in sessions(view.domain) {
        let of = format!("node {}", view.name_of(node));
        let shown = [
            ("interfaces", usage.interfaces, Limit::InterfacesPerSession),
            ("links", usage.links, Limit::LinksPerSession),
            ("refusals", usage.refusals, Limit::RefusalsPerSession),
            ("unlinked pairs", usage.unlinked, Limit::UnlinkedPerSession),
        ];
        let is_idle = shown.iter().all(|(_, used, _)| *used == 0);
        for (quota, used, kind) in shown.into_iter().filter(|_| !is_idle) {
            add(&of, quota, used, kind);
        }
    }
    quotas
}

/// A limit is near when at least this share of it is used.
pub(crate) const NEAR_PERCENT: u64 = 80;

/// The limits that a command shows to people. In JSON it shows all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Args)]
pub(crate) struct Shown {
    /// Show all limits and their use, not only those that are used to 80 % or more
    #[arg(long)]
    limits: bool,
}

impl Shown {
    /// Whether the use of a limit is shown.
    pub(crate) fn has(self, quota: &Quota) -> bool {
        self.limits || quota.is_near()
    }
}

/// A row for people: a limit, and its greatest use.
pub(crate) struct LimitRow {
    name: String,
    value: u32,
    most: Option<String>,
}

impl Row for LimitRow {
    const COLUMNS: &'static [Column<Self>] = &[
        ("LIMIT", |it| it.name.clone()),
        ("VALUE", |it| it.value.to_string()),
        ("MOST USED", |it| cell(it.most.as_ref())),
    ];
}

/// The rows of the limits that are shown, if the limits are known.
pub(crate) fn rows(
    limits: Option<&LimitsInForce>,
    quotas: &[Quota],
    shown: Shown,
) -> Vec<LimitRow> {
    let limits = limits.into_iter().flat_map(|it| &it.0.limits);
    let row = |limit: &StatedLimit| {
        let name = limit.name.as_str();
        let of_limit = quotas.iter().filter(|it| it.kind.name() == name);
        let most = of_limit.max_by_key(|it| it.used);
        let is_shown = shown.limits || most.is_some_and(Quota::is_near);
        is_shown.then(|| LimitRow {
            name: name.to_owned(),
            value: limit.value,
            most: most.map(|it| format!("{} by {}", it.used, it.of)),
        })
    };
    limits.filter_map(row).collect()
}

#[cfg(test)]
mod reference;
