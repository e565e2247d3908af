//! The fingerprint of a moment, which ignores the choice of names.
//!
//! Two moments with one fingerprint differ in nothing that a machine or this harness uses. So the
//! same actions follow on both, and the same properties hold:
//!
//! - Links and sessions are renumbered in the order of their numbers. Machines only compare these
//!   numbers with each other, and assign new ones that are greater than all earlier ones.
//! - The key of a link stands for the number of its link. A key that does not belong to its link
//!   keeps its value.
//! - The revision of a Manager is left out. It appears only in pages and WATCH, and no node
//!   watches.
//! - Times are relative to the current time.
//! - A node never uses the number of its session or the identity of a link's peer: both go to its
//!   program, and programs do not use them here. So the words of a node contain neither.
//! - Nodes of equal programs are sorted by their states. If two of them have the same state, their
//!   own order stays. Then one moment may have several fingerprints, which only costs search time.
//!
//! Interfaces keep their numbers.

use super::{
    Scope,
    program::{Connection, End, Program},
    tape::{BEGIN, Tape, Word, epoch_of, link_word, session_number},
    world::World,
};

/// The new numbers of the links and sessions of one moment.
struct Names {
    links: Vec<u64>,
    sessions: Vec<u64>,
    now: u64,
}

impl World {
    /// Returns the fingerprint of this moment.
    #[must_use]
    pub fn print(&self, scope: &Scope) -> u64 {
        let manager = self.manager.as_deref().map(|it| it.tape(&self.keys));
        let tapes: Vec<_> = self.programs.iter().map(|it| self.tape(it)).collect();
        let mut links: Vec<_> = self.pairs.keys().copied().map(link_word).collect();
        for tape in tapes.iter().copied().chain(manager) {
            links.extend(&tape.links);
        }
        links.sort_unstable();
        links.dedup();
        let names = Names {
            links,
            sessions: manager.map(|it| it.sessions.clone()).unwrap_or_default(),
            now: self.now.0 - BEGIN.0,
        };
        let own = tapes.iter().zip(&self.programs);
        let own: Vec<_> = own.map(|(tape, it)| names.own(tape, it)).collect();
        let renamed = ranks(scope, &own);

        let mut mix = Mix::default();
        mix.word(self.epoch);
        mix.word(self.policy.restricted.into());
        let budget = self.budget;
        for left in [
            budget.withdrawals,
            budget.closes,
            budget.node_crashes,
            budget.manager_crashes,
            budget.stalls,
            budget.shutdowns,
            budget.reloads,
        ] {
            mix.word(left.into());
        }
        if let Some(tape) = manager {
            names.manager(tape, &renamed, &mut mix);
        }
        let mut places: Vec<_> = (0..own.len()).collect();
        places.sort_unstable_by_key(|&at| renamed[at]);
        for at in places {
            mix.word(own[at]);
        }
        self.mix_pairs(&names, &renamed, &mut mix);
        mix.finish()
    }

    fn tape<'a>(&self, program: &'a Program) -> &'a Tape {
        program.taped.tape(|| Tape::of(&self.keys, program))
    }

    fn mix_pairs(&self, names: &Names, renamed: &[u8], mix: &mut Mix) {
        for (&link, pair) in &self.pairs {
            mix.word(names.link(link_word(link)));
            for (end, socket) in pair.ends.iter().zip(pair.sockets) {
                mix.word(end_word(*end, renamed));
                mix.word(socket as u64);
            }
            mix.word(pair.doomed.into());
        }
        let broken = self.broken.iter().map(|ends| {
            let mut ends = ends.map(|end| end_word(end, renamed));
            ends.sort_unstable();
            ends
        });
        let mut broken: Vec<_> = broken.collect();
        broken.sort_unstable();
        mix.word(broken.len() as u64);
        broken.into_iter().flatten().for_each(|end| mix.word(end));
    }
}

impl Names {
    fn link(&self, word: u64) -> u64 {
        let rank = self.links.partition_point(|it| *it < word);
        epoch_of(word) << 16 | rank as u64
    }

    /// Returns the new number of a session, or 0 if the Manager does not know the session.
    fn session(&self, number: u64) -> u64 {
        let rank = self.sessions.binary_search(&number);
        rank.map_or(0, |rank| rank as u64 + 1)
    }

    /// The state of a node, without its identity.
    fn own(&self, tape: &Tape, program: &Program) -> u64 {
        let mut mix = Mix::default();
        for word in tape.words() {
            match word {
                Word::Plain(word) => mix.word(word),
                Word::Link(word) => mix.word(self.link(word)),
                Word::Time(time) => mix.word(time.wrapping_sub(self.now)),
                Word::Session(_) | Word::Name(_) => {}
            }
        }
        let session = |it: &Connection| self.session(session_number(it.session));
        let live = program.connection.iter().filter(|it| !it.dead);
        mix.word(live.map(session).next().unwrap_or(u64::MAX));
        program.closed.iter().for_each(|it| mix.word(session(it)));
        mix.finish()
    }

    /// Mixes the words of a Manager. Consecutive names are a set, so they are sorted by their new
    /// numbers.
    fn manager(&self, tape: &Tape, renamed: &[u8], mix: &mut Mix) {
        let mut together: Vec<u8> = Vec::new();
        for word in tape.words() {
            if let Word::Name(at) = word {
                together.push(renamed[usize::from(at)]);
                continue;
            }
            together.sort_unstable();
            together.drain(..).for_each(|at| mix.word(at.into()));
            match word {
                Word::Plain(word) => mix.word(word),
                Word::Link(word) => mix.word(self.link(word)),
                Word::Time(time) => mix.word(time.wrapping_sub(self.now)),
                Word::Session(number) => mix.word(self.session(number)),
                Word::Name(_) => {}
            }
        }
    }
}

/// Returns the new number of each node: nodes of equal programs are sorted by their states.
fn ranks(scope: &Scope, own: &[u64]) -> Vec<u8> {
    let programs = &scope.programs;
    let mut renamed: Vec<u8> = (0_u8..).take(own.len()).collect();
    for first in 0..own.len() {
        let alike = |at: &usize| programs[*at] == programs[first];
        let mut class: Vec<_> = (0..own.len()).filter(alike).collect();
        if class[0] != first || class.len() == 1 {
            continue;
        }
        let places = class.clone();
        class.sort_by_key(|&at| own[at]);
        for (at, place) in class.into_iter().zip(places) {
            renamed[at] = u8::try_from(place).unwrap_or(u8::MAX);
        }
    }
    renamed
}

fn end_word((at, life, interface): End, renamed: &[u8]) -> u64 {
    let at = renamed.get(usize::from(at)).copied().unwrap_or(at);
    u64::from(at) << 56 | u64::from(life) << 48 | interface.0
}

/// A hash of words. Its steps are invertible, so that short texts rarely have equal fingerprints.
#[derive(Default)]
struct Mix(u64);

impl Mix {
    fn word(&mut self, word: u64) {
        let mixed = (self.0.rotate_left(23) ^ word).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.0 = mixed ^ mixed >> 29;
    }

    fn finish(self) -> u64 {
        let mixed = (self.0 ^ self.0 >> 32).wrapping_mul(0xD6E8_FEB8_6659_FD93);
        mixed ^ mixed >> 32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The counts of states in each build are those of the first one, also where fingerprints collide.
    #[test]
    fn fingerprints_are_the_same_in_each_build() {
        let print = |words: &[u64]| {
            let mut mix = Mix::default();
            words.iter().for_each(|it| mix.word(*it));
            mix.finish()
        };
        assert_eq!(print(&[1]), 0xF9FF_0B40_CB66_EC99);
        assert_eq!(print(&[1, 2, 3]), 0x3160_0C5B_92D1_1E06);
        assert_eq!(print(&[u64::MAX, 1 << 63]), 0x4C7A_1B62_41E9_6069);
    }
}
