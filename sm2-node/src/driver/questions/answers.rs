//! Answers of the Manager. Each method returns the input that sends the next question, if one waits.

use std::os::fd::OwnedFd;

use sm2_proto::control::{self, ReloadOutcome};
use sm2_proto::node::Input;

use super::{Answer, Page, Question, Questions};

impl Questions {
    pub(in crate::driver) fn page_came(
        &mut self,
        epoch: u64,
        page: control::Page,
    ) -> Option<Input<'static>> {
        let control::Page {
            revision,
            items,
            next,
        } = page;
        self.answer_came(0, |questions, question| {
            let first = matches!(question, Question::FirstPage);
            Answer::Page(Page {
                epoch,
                revision,
                items,
                next,
                follower: first.then(|| questions.follow(epoch, revision)),
            })
        })
    }

    pub(in crate::driver) fn counters_came(
        &mut self,
        file: Option<OwnedFd>,
    ) -> Option<Input<'static>> {
        self.answer_came(1, |_, _| Answer::Counters(file))
    }

    pub(in crate::driver) fn schema_came(
        &mut self,
        text: Option<String>,
    ) -> Option<Input<'static>> {
        self.answer_came(2, |_, _| Answer::Schema(text))
    }

    pub(in crate::driver) fn reload_came(
        &mut self,
        outcome: ReloadOutcome,
    ) -> Option<Input<'static>> {
        self.answer_came(3, |_, _| Answer::Reloaded(outcome))
    }

    fn answer_came(
        &mut self,
        kind: usize,
        answer: impl FnOnce(&mut Self, Question) -> Answer,
    ) -> Option<Input<'static>> {
        let (answered, next) = self.answered(kind);
        if let Some((ticket, question)) = answered {
            let answer = answer(self, question);
            self.answers.insert(ticket, Some(answer));
        }
        next
    }
}
