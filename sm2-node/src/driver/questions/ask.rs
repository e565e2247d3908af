//! Questions of threads, and waiting for the answers.

use sm2_proto::Instant;
use sm2_proto::node::Input;

use super::{Answer, Followed, Lost, Question, Ticket};
use crate::driver::control::Control;
use crate::driver::datagram::Incoming;
use crate::driver::event_sets::NodeSets;
use crate::driver::shared_node::NodeState;
use crate::driver::wait::WaitFailure;
use crate::error::QueryError;

impl Control {
    fn ask(&mut self, question: Question, sets: &NodeSets) -> Ticket {
        let (ticket, input) = self.questions.ask(question);
        if let Some(input) = input {
            self.session.tell(input);
            self.drain_session(Incoming::default(), sets);
        }
        ticket
    }

    /// Makes sure that the Manager sends a PAGE after the frames that are on their way now.
    pub(in crate::driver) fn expect_page(&mut self, sets: &NodeSets) {
        if self.session.is_ready()
            && let Some(input) = self.questions.expect_page()
        {
            self.session.tell(input);
            self.drain_session(Incoming::default(), sets);
        }
    }

    /// The changes that a follower has collected once it has reached this revision. Requests them
    /// if necessary.
    fn followed(
        &mut self,
        ticket: Ticket,
        revision: u64,
        sets: &NodeSets,
    ) -> Option<Result<Followed, Lost>> {
        let Some(follower) = self.questions.followers.get_mut(&ticket) else {
            return Some(Err(Lost));
        };
        if !follower.lost && follower.revision >= revision && !follower.more {
            return Some(Ok(Followed {
                revision: follower.revision,
                changes: std::mem::take(&mut follower.changes),
            }));
        }
        let after = follower.revision;
        follower.lost |= self.session.epoch() != Some(follower.epoch);
        match self.questions.watching {
            _ if follower.lost => return Some(Err(Lost)),
            // Another follower waits for changes after a later revision, which may never come.
            Some(later) if later > after => return Some(Err(Lost)),
            Some(_) => {}
            None => {
                self.questions.watching = Some(after);
                self.session.tell(Input::Watch { after });
                self.drain_session(Incoming::default(), sets);
            }
        }
        None
    }
}

impl NodeState {
    /// Asks a question unless `asked` says that it was asked, and waits for the answer. The
    /// question is sent as soon as a Manager is connected. `None` if the session ended before the
    /// answer came. At the end of the wait, `asked` remains: the caller calls again with it, or
    /// [abandons](Self::abandon) it.
    pub(crate) fn ask_once(
        &self,
        question: &Question,
        asked: &mut Option<Ticket>,
        until: Option<Instant>,
    ) -> Result<Option<Answer>, QueryError> {
        let answer = self.wait(until, |control| {
            if asked.is_none() && control.session.is_ready() {
                *asked = Some(control.ask(question.clone(), &self.sets));
            }
            let ticket = (*asked)?;
            match control.questions.answers.get(&ticket) {
                Some(None) => None,
                Some(Some(_)) | None => {
                    *asked = None;
                    Some(control.questions.answers.remove(&ticket).flatten())
                }
            }
        });
        answer
            .map_err(QueryError::from)?
            .ok_or_else(|| self.too_late())
    }

    /// Asks until a Manager answers, each new Manager again.
    pub(crate) fn ask(
        &self,
        question: &Question,
        until: Option<Instant>,
    ) -> Result<Answer, QueryError> {
        let mut asked = None;
        loop {
            match self.ask_once(question, &mut asked, until) {
                Ok(Some(answer)) => return Ok(answer),
                Ok(None) => {}
                Err(error) => {
                    self.abandon(asked);
                    return Err(error);
                }
            }
        }
    }

    /// Drops a question for whose answer no thread waits any more.
    pub(crate) fn abandon(&self, asked: Option<Ticket>) {
        if let Some(ticket) = asked {
            self.lock().questions.abandon(ticket);
        }
    }

    /// The error for an answer that did not come in time.
    pub(crate) fn too_late(&self) -> QueryError {
        self.lock()
            .away()
            .map_or(QueryError::TimedOut, QueryError::ManagerGone)
    }

    /// Follows the changes after this revision. The caller must [unfollow](Self::unfollow) the
    /// result.
    pub(crate) fn follow(&self, epoch: u64, revision: u64) -> Ticket {
        self.lock().questions.follow(epoch, revision)
    }

    pub(crate) fn unfollow(&self, follower: Ticket) {
        self.lock().questions.followers.remove(&follower);
    }

    /// Waits until a follower has all changes up to at least this revision. `None` if `until` has
    /// passed.
    pub(crate) fn wait_followed(
        &self,
        follower: Ticket,
        revision: u64,
        until: Option<Instant>,
    ) -> Result<Option<Result<Followed, Lost>>, WaitFailure> {
        self.wait(until, |control| {
            control.followed(follower, revision, &self.sets)
        })
    }
}
