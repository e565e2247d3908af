//! The task that says what another configuration would change. It changes nothing.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Duration,
};

use sm2_proto::{Name, gateway::GatewayId};
use tokio::{
    sync::{mpsc, oneshot, watch},
    task::block_in_place,
};

use super::{
    Message,
    connection::{Shared, lock},
};
use crate::{
    Config,
    report::ShadowReport,
    shadow::{Change, RuleSet, Seen, changes},
};

/// How often it is looked whether there is something new.
const LOOK: Duration = Duration::from_millis(500);

/// What the hub knows, for those who do not know it yet.
#[derive(Debug)]
pub(crate) struct View {
    /// Another number, another view.
    pub(super) revision: u64,
    pub(super) rules: RuleSet,
    pub(super) names: BTreeMap<GatewayId, Name>,
    pub(super) seen: Seen,
}

/// Says what each configuration that comes would change, and what changes with what is there.
pub(super) async fn run(
    mut configs: watch::Receiver<Option<Arc<Config>>>,
    hub: mpsc::Sender<Message>,
    shared: Arc<Shared>,
) {
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
        let (answer, answered) = oneshot::channel();
        let known = revision;
        if hub.send(Message::View { known, answer }).await.is_err() {
            return;
        }
        let Ok(view) = answered.await else { return };
        if let Some(view) = view {
            revision = view.revision;
            let known = config.peers.iter().map(|it| (it.id, it.name.clone()));
            let names: BTreeMap<_, _> = known.chain(view.names).collect();
            let changes = block_in_place(|| {
                let then = RuleSet::from(&*config);
                changes(&view.rules, &then, &view.seen)
            });
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
