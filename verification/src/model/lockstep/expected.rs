//! The inputs of each member without the machines: plain lists, round by round.

use super::inputs::{Handled, INPUT_NS, Kind, TICK_NS};
use super::scope::LockstepScope;

/// The inputs that each member handles, in order, if nobody joins or leaves.
pub(super) fn logs(scope: &LockstepScope) -> Vec<Vec<Handled>> {
    let mut logs = vec![Vec::new(); scope.members];
    let mut tick = scope.timer.then_some(INPUT_NS + TICK_NS);
    let mut step = 0;
    for input in 1..=u64::from(scope.inputs) {
        let time = input * INPUT_NS;
        // Ticks before the input have steps of their own.
        while let Some(due) = tick.filter(|due| *due < time) {
            step += 1;
            run(&mut logs, step, Vec::new(), true);
            tick = Some(due + TICK_NS);
        }
        step += 1;
        let ticks = tick == Some(time);
        run(&mut logs, step, vec![Kind::Input], ticks);
        tick = tick.map(|due| due + if ticks { TICK_NS } else { 0 });
    }
    logs
}

fn run(logs: &mut [Vec<Handled>], step: u64, mut published: Vec<Kind>, ticks: bool) {
    let mut round = 0;
    let mut ticks = ticks;
    while !published.is_empty() || ticks {
        let mut next = Vec::new();
        for (member, log) in logs.iter_mut().enumerate() {
            let mut inputs: Vec<_> = published.clone();
            inputs.retain(|it| it.is_for(member));
            inputs.sort();
            if ticks && member == 1 {
                inputs.push(Kind::Tick);
            }
            for kind in inputs {
                log.push(Handled { step, round, kind });
                next.extend(kind.answer(member));
            }
        }
        (published, ticks) = (next, false);
        round += 1;
    }
}
