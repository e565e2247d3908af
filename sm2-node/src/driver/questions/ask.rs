//! Questions of threads, and waiting for the answers.

use sm2_proto::Instant;

use super::{Answer, Followed, Lost, Question, Ticket};
use crate::driver::datagram::Incoming;
use crate::driver::shared_node::NodeState;
use crate::driver::wait::WaitFailure;
use crate::error::QueryError;

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
                let (ticket, input) = control.questions.ask(question.clone());
                *asked = Some(ticket);
                if let Some(input) = input {
                    control.session.tell(input);
                    control.drain_session(Incoming::default(), &self.sets);
                }
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
            let session = &mut control.session;
            let followed = control.questions.followed(follower, revision, session);
            control.drain_session(Incoming::default(), &self.sets);
            followed
        })
    }
}
