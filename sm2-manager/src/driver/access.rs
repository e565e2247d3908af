//! Reading the access policy again while the Manager serves (SM2-ACC-013).

use std::sync::Arc;

use sm2_proto::manager::Input;
use tracing::{info, warn};

use super::Manager;
use crate::policy_file;

impl Manager {
    /// Reads the policy if a handle or a node asked for that, and reports once a policy is applied. While another
    /// Manager may take the lock, the policy waits: it is read and replaced only under the lock.
    //= SM2-ACC-012, SM2-ACC-013, SM2-ACC-016
    pub(super) fn reload_policy(&mut self) {
        if self.reload.is_due && self.door.is_open() {
            self.reload.is_due = false;
            match policy_file::of_domain(self.door.path(), &self.reload.options) {
                Ok(file) => {
                    if file.is_some() || self.machine.has_access_policy() {
                        self.reload.applying = Some(file.as_ref().map(|it| it.path.clone()));
                    }
                    let policy = file.map(|it| Arc::new(it.policy));
                    self.feed(Input::SetAccessPolicy(policy));
                }
                Err(error) => {
                    warn!(%error, "cannot read the access policy again: the one before stays in force");
                    self.feed(Input::AccessPolicyUnusable {
                        problem: error.problem(),
                        text: &error.to_string(),
                    });
                }
            }
        }
        if !self.machine.is_applying_policy() {
            match self.reload.applying.take() {
                Some(Some(path)) => {
                    info!(policy = %path.display(), "the new access policy is applied")
                }
                Some(None) => {
                    info!("the domain has no access policy any more: everything is allowed")
                }
                None => {}
            }
        }
    }
}
