//! Lets a person walk through a scope.

use std::{
    fmt,
    io::{self, BufRead, Write},
};

use super::{
    super::{Failure, System},
    Action, Scope,
    program::{Connection, Down, Program},
    world::{Pair, World},
};

/// Shows a moment and its possible actions. The person chooses an action by number, goes back with
/// `b`, and quits with `q`. Reports a property that does not hold.
///
/// Shows all possible actions, including those that a reduced search skips.
///
/// # Errors
///
/// The input or output fails.
pub fn walk_by_hand(
    scope: &Scope,
    ask: &mut impl BufRead,
    tell: &mut impl Write,
) -> io::Result<()> {
    let scope = Scope {
        reduced: false,
        ..scope.clone()
    };
    let mut moments = match scope.first() {
        Ok(first) => vec![first],
        Err(failure) => return writeln!(tell, "{failure}"),
    };
    while let Some(world) = moments.last() {
        let actions = show(&scope, world, tell)?;
        write!(tell, "step {}> ", moments.len())?;
        tell.flush()?;
        let mut line = String::new();
        if ask.read_line(&mut line)? == 0 {
            break;
        }
        match line.trim() {
            "q" => break,
            "b" if moments.len() > 1 => drop(moments.pop()),
            number => {
                let number = number
                    .parse::<usize>()
                    .ok()
                    .and_then(|it| it.checked_sub(1));
                let Some(&action) = number.and_then(|it| actions.get(it)) else {
                    writeln!(tell, "a number from the list, b for back, q to quit")?;
                    continue;
                };
                match scope.step(world, action) {
                    Ok(next) => moments.push(next),
                    Err(failure) => writeln!(tell, "{action}\nDOES NOT HOLD: {failure}")?,
                }
            }
        }
    }
    Ok(())
}

fn show(scope: &Scope, world: &World, tell: &mut impl Write) -> io::Result<Vec<Action>> {
    let actions = scope.actions(world);
    writeln!(tell)?;
    show_world(world, tell)?;
    match scope.check(world, &actions) {
        Ok(true) => writeln!(tell, "all is quiet, and as it should be")?,
        Ok(false) => {}
        Err(Failure { property, what }) => writeln!(tell, "DOES NOT HOLD: {property:?}: {what}")?,
    }
    for (number, action) in (1..).zip(&actions) {
        writeln!(tell, "{number:3} {action}")?;
    }
    Ok(actions)
}

fn show_world(world: &World, tell: &mut impl Write) -> io::Result<()> {
    match &world.manager {
        Some(manager) => {
            let manager = manager.machine();
            let (sessions, links) = (manager.sessions(), manager.links());
            writeln!(
                tell,
                "Manager {}: {sessions} sessions, {links} links",
                world.epoch
            )?;
        }
        None => writeln!(tell, "no Manager")?,
    }
    for (at, program) in world.programs.iter().enumerate() {
        writeln!(tell, "node {at}, process {}: {program}", program.life)?;
    }
    for (link, pair) in &world.pairs {
        writeln!(tell, "{link}: {pair}")?;
    }
    writeln!(tell, "still possible: {:?}", world.budget)
}

impl fmt::Display for Program {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for interface in self.interfaces.keys() {
            write!(f, "{interface}, ")?;
        }
        match &self.connection {
            None => write!(f, "not connected")?,
            Some(it) if self.node.is_ready() => write!(f, "ready{it}")?,
            Some(it) => write!(f, "connected{it}")?,
        }
        for closed in &self.closed {
            write!(f, "\n  a connection that it has closed{closed}")?;
        }
        Ok(())
    }
}

impl fmt::Display for Connection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.dead {
            write!(f, ", the Manager's end is gone")?;
        }
        for frame in &self.up {
            write!(f, "\n  to the Manager: {:?}", frame.says)?;
        }
        for down in &self.down {
            match down {
                Down::Frame(frame, _) => write!(f, "\n  to the node: {:?}", frame.says)?,
                Down::Eof => write!(f, "\n  to the node: the end")?,
            }
        }
        Ok(())
    }
}

impl fmt::Display for Pair {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [one, other] = self
            .ends
            .map(|(at, life, it)| format!("{it} of node {at}.{life}"));
        let [ours, theirs] = self.sockets;
        write!(f, "{one} ({ours:?}) with {other} ({theirs:?})")?;
        if self.doomed {
            write!(f, ", to end")?;
        }
        Ok(())
    }
}
