//! The service that lets other programs control a player.

use std::collections::VecDeque;

use sm2_node::{DeclareError, Node, RecvError, Request, Server, WaitSet};
use sm2_proto::Name;

use super::control::{PlayCommand, PlayControl};

/// The service, and the calls that wait for an answer.
pub(super) struct ControlService {
    server: Server<str, str>,
    control: PlayControl,
    /// Calls whose commands the player has got.
    received: Vec<Request<str, str>>,
    /// Calls whose steps are not over.
    steps: VecDeque<Request<str, str>>,
}

impl ControlService {
    pub(super) fn new(
        node: &Node,
        service: &Name,
        control: PlayControl,
    ) -> Result<Self, DeclareError> {
        Ok(Self {
            server: node.server(service.as_str())?,
            control,
            received: Vec::new(),
            steps: VecDeque::new(),
        })
    }

    pub(super) fn add_to<T: Clone>(&self, set: &mut WaitSet<'_, T>, tag: T) -> std::io::Result<()> {
        set.add(&self.server, tag).map(drop)
    }

    /// Takes the calls that are there, and gives their commands to the player. The calls are answered by
    /// [`reply`](Self::reply) and [`step_is_over`](Self::step_is_over).
    pub(super) fn receive(&mut self) -> Result<(), RecvError> {
        loop {
            match self.server.try_recv() {
                Ok(Some(request)) => self.command(request),
                Ok(None) => return Ok(()),
                // A request that is not a string has got its answer.
                Err(RecvError::Payload { .. }) => {}
                Err(error) => return Err(error),
            }
        }
    }

    fn command(&mut self, request: Request<str, str>) {
        let command = request.parse();
        match command.and_then(|it| self.control.send(it).map(|()| it)) {
            Ok(PlayCommand::Step) => self.steps.push_back(request),
            Ok(_) => self.received.push(request),
            // Without its client, nobody needs the answer; the same holds below.
            Err(error) => drop(request.fail(&error.to_string())),
        }
    }

    /// Answers the calls whose commands the player has followed. After the end of a pause, that includes all steps.
    pub(super) fn reply(&mut self, is_paused: bool) {
        if !is_paused {
            self.received.extend(self.steps.drain(..));
        }
        for request in std::mem::take(&mut self.received) {
            self.answer(request);
        }
    }

    /// Answers the first call for a step.
    pub(super) fn step_is_over(&mut self) {
        if let Some(request) = self.steps.pop_front() {
            self.answer(request);
        }
    }

    fn answer(&self, request: Request<str, str>) {
        let status = serde_json::to_string(&self.control.status());
        let _ = request.reply(&status.expect("numbers and a flag"));
    }

    /// Answers the calls for steps that will not come.
    pub(super) fn end(&mut self) {
        for request in self.steps.drain(..) {
            let _ = request.fail("the replay has ended");
        }
    }
}
