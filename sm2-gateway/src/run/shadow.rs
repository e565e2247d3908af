//! The shadow task: logs and reports what another configuration would change, without effect.
//!
//! The comparison is a pure function over the present offers, evaluated beside the hub. After a change, the task
//! requests a view from the hub, at most twice a second, so trying out rules costs the messages nothing.

use std::{
    collections::{BTreeMap, BTreeSet},
    mem,
    sync::Arc,
    time::Duration,
};

use tokio::sync::watch;

use super::{
    gateway_state::{GatewayState, lock},
    thread::on_thread,
};
use crate::{
    config::Config,
    report::ShadowReport,
    shadow::{Change, changes},
};

/// Interval of the checks for changed rules and subjects.
const POLL_INTERVAL: Duration = Duration::from_millis(500);

/// Compares each configuration with the current state: at once, and again when the state changes.
pub(super) async fn run(
    mut configs: watch::Receiver<Option<Arc<Config>>>,
    shared: Arc<GatewayState>,
) {
    let mut revision = 0;
    let mut logged = BTreeSet::new();
    loop {
        let config = configs.borrow_and_update().clone();
        let Some(config) = config else {
            if configs.changed().await.is_err() {
                return;
            }
            continue;
        };
        let Ok(snapshot) = shared.hub.snapshot(revision).await else {
            return;
        };
        if let Some(mut snapshot) = snapshot {
            let known = config.peers.iter().map(|it| (it.id, it.name.clone()));
            let names = mem::take(&mut snapshot.names);
            let names: BTreeMap<_, _> = known.chain(names).collect();
            let (compared, new_rules) = (snapshot.revision, config.rule_set());
            let compare = move || changes(&snapshot.rules, &new_rules, &snapshot.seen);
            let changes = match on_thread("shadow", compare).await {
                Ok(changes) => changes,
                Err(error) => {
                    tracing::warn!(%error, "cannot compare with the shadow configuration; retries");
                    tokio::time::sleep(POLL_INTERVAL).await;
                    continue;
                }
            };
            revision = compared;
            let report = |it: &Change| ShadowReport::new(it, &names, &config.rule_lines);
            for change in changes.iter().filter(|it| !logged.contains(*it)) {
                tracing::info!("shadow: {}", report(change));
            }
            let reports = changes.iter().map(report);
            *lock(&shared.shadow) = Some(reports.collect());
            logged = changes.into_iter().collect();
        }
        tokio::select! {
            () = tokio::time::sleep(POLL_INTERVAL) => {}
            changed = configs.changed() => {
                if changed.is_err() {
                    return;
                }
                // Compares and logs everything again: the lines of rules may differ.
                revision = 0;
                logged.clear();
            }
        }
    }
}
