//! The task that says what another configuration would change. It changes nothing.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Duration,
};

use tokio::{sync::watch, task::block_in_place};

use super::shared::{Shared, lock};
use crate::{
    config::Config,
    report::ShadowReport,
    shadow::{Change, changes},
};

/// How often it is looked whether there is something new.
const LOOK: Duration = Duration::from_millis(500);

/// Says what each configuration that comes would change, and what changes with what is there.
pub(super) async fn run(mut configs: watch::Receiver<Option<Arc<Config>>>, shared: Arc<Shared>) {
    let mut revision = 0;
    let mut told = BTreeSet::new();
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
        if let Some(snapshot) = snapshot {
            revision = snapshot.revision;
            let known = config.peers.iter().map(|it| (it.id, it.name.clone()));
            let names: BTreeMap<_, _> = known.chain(snapshot.names).collect();
            let changes =
                block_in_place(|| changes(&snapshot.rules, &config.rule_set(), &snapshot.seen));
            let report = |it: &Change| ShadowReport::new(it, &names, &config);
            for change in changes.iter().filter(|it| !told.contains(*it)) {
                tracing::info!("shadow: {}", report(change));
            }
            let reports = changes.iter().map(report);
            *lock(&shared.shadow) = Some(reports.collect());
            told = changes.into_iter().collect();
        }
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            changed = configs.changed() => {
                if changed.is_err() {
                    return;
                }
                // All of it is said again: lines may be others.
                revision = 0;
                told.clear();
            }
        }
    }
}
