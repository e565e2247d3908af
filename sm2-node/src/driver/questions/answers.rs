//! Answers of the Manager. These functions feed the session; their caller drains it.

use std::os::fd::OwnedFd;

use sm2_proto::control::{Change, Item, Key, ReloadOutcome};

use super::{Answer, Page, Question, Questions};
use crate::driver::control::Control;

impl Control {
    pub(in crate::driver) fn page_came(
        &mut self,
        revision: u64,
        items: Vec<Item>,
        next: Option<Key>,
    ) {
        let epoch = self.session.epoch().unwrap_or_default();
        self.answer_came(0, |questions, question| {
            let first = matches!(question, Question::FirstPage);
            Answer::Page(Page {
                epoch,
                revision,
                items,
                next,
                follower: first.then(|| questions.follow(epoch, revision)),
            })
        });
    }

    pub(in crate::driver) fn counters_came(&mut self, file: Option<OwnedFd>) {
        self.answer_came(1, |_, _| Answer::Counters(file));
    }

    pub(in crate::driver) fn schema_came(&mut self, text: Option<String>) {
        self.answer_came(2, |_, _| Answer::Schema(text));
    }

    pub(in crate::driver) fn reload_came(&mut self, outcome: ReloadOutcome) {
        self.answer_came(3, |_, _| Answer::Reloaded(outcome));
    }

    pub(in crate::driver) fn changes_came(
        &mut self,
        revision: u64,
        changes: Option<&[Change]>,
        more: bool,
    ) {
        self.questions.changes(revision, changes, more);
        self.sleepers.wake();
    }

    fn answer_came(
        &mut self,
        kind: usize,
        answer: impl FnOnce(&mut Questions, Question) -> Answer,
    ) {
        let (answered, next) = self.questions.answered(kind);
        if let Some((ticket, question)) = answered {
            let answer = answer(&mut self.questions, question);
            self.questions.answers.insert(ticket, Some(answer));
        }
        if let Some(input) = next {
            self.session.tell(input);
        }
        self.sleepers.wake();
    }
}
