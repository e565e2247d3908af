//! Cycles in the dependencies between the files of a crate.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    fmt,
    path::{Path, PathBuf},
};

use super::edges::Edge;

/// How many of the shortest cycles are shown.
const SHOWN_MAX: usize = 8;

/// Files that all depend on each other, and the edges between them.
#[derive(Debug)]
pub(crate) struct Knot {
    pub(crate) files: BTreeSet<PathBuf>,
    edges: Vec<Edge>,
}

/// The strongly connected components of more than one file.
pub(crate) fn knots(edges: &[Edge]) -> Vec<Knot> {
    let graph = Graph::new(edges);
    let mut left: BTreeSet<&Path> = graph.files.clone();
    let mut knots = Vec::new();
    while let Some(&file) = left.first() {
        let after = graph.reachable(file, &graph.forward);
        let before = graph.reachable(file, &graph.backward);
        let files: BTreeSet<&Path> = after.intersection(&before).copied().collect();
        left.retain(|it| !files.contains(it));
        if files.len() > 1 {
            let is_inside =
                |it: &&Edge| files.contains(it.from.as_path()) && files.contains(it.to.as_path());
            knots.push(Knot {
                edges: edges.iter().filter(is_inside).cloned().collect(),
                files: files.into_iter().map(Path::to_owned).collect(),
            });
        }
    }
    knots
}

impl Knot {
    /// The shortest cycle that goes over this edge.
    fn cycle_over(&self, first: &Edge) -> Vec<&Edge> {
        let mut came: BTreeMap<&Path, &Edge> = BTreeMap::new();
        let mut queue = VecDeque::from([first.to.as_path()]);
        while let Some(file) = queue.pop_front() {
            for edge in self.edges.iter().filter(|it| it.from == file) {
                if edge.to != first.to && !came.contains_key(edge.to.as_path()) {
                    came.insert(&edge.to, edge);
                    queue.push_back(&edge.to);
                }
            }
        }
        let mut cycle = Vec::new();
        let mut at = first.from.as_path();
        while at != first.to {
            let edge = came[at];
            cycle.push(edge);
            at = &edge.from;
        }
        cycle.reverse();
        cycle
    }

    /// The shortest cycles, each once.
    fn cycles(&self) -> Vec<Vec<&Edge>> {
        let mut seen = BTreeSet::new();
        let mut cycles = Vec::new();
        for edge in &self.edges {
            let mut cycle = vec![edge];
            cycle.extend(self.cycle_over(edge));
            let files: BTreeSet<&Path> = cycle.iter().map(|it| it.from.as_path()).collect();
            if seen.insert(files) {
                cycles.push(cycle);
            }
        }
        cycles.sort_by_key(Vec::len);
        cycles
    }
}

impl fmt::Display for Knot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} files depend on each other:", self.files.len())?;
        for file in &self.files {
            writeln!(f, "    {}", file.display())?;
        }
        for cycle in self.cycles().iter().take(SHOWN_MAX) {
            writeln!(f, "  a cycle:")?;
            for edge in cycle {
                let (from, to) = (edge.from.display(), edge.to.display());
                writeln!(f, "    {from}:{} names {} of {to}", edge.line, edge.path)?;
            }
        }
        Ok(())
    }
}

type Neighbours<'a> = BTreeMap<&'a Path, Vec<&'a Path>>;

struct Graph<'a> {
    files: BTreeSet<&'a Path>,
    forward: Neighbours<'a>,
    backward: Neighbours<'a>,
}

impl<'a> Graph<'a> {
    fn new(edges: &'a [Edge]) -> Self {
        let mut graph = Self {
            files: BTreeSet::new(),
            forward: BTreeMap::new(),
            backward: BTreeMap::new(),
        };
        for Edge { from, to, .. } in edges {
            graph.files.extend([from.as_path(), to.as_path()]);
            graph.forward.entry(from).or_default().push(to);
            graph.backward.entry(to).or_default().push(from);
        }
        graph
    }

    fn reachable(&self, start: &'a Path, neighbours: &Neighbours<'a>) -> BTreeSet<&'a Path> {
        let mut reached = BTreeSet::from([start]);
        let mut queue = vec![start];
        while let Some(file) = queue.pop() {
            for &next in neighbours.get(file).into_iter().flatten() {
                if reached.insert(next) {
                    queue.push(next);
                }
            }
        }
        reached
    }
}
