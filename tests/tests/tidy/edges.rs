//! Which file of a crate depends on which: paths resolved to the file that defines the item.

use std::path::{Path, PathBuf};

use super::modules::Module;

/// How many imports may lead from one to the next: an import of its own name ends here.
const IMPORTS_MAX: usize = 16;

/// `from` names something that `to` defines.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Edge {
    pub(crate) from: PathBuf,
    pub(crate) to: PathBuf,
    pub(crate) line: usize,
    pub(crate) path: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Target {
    Module(usize),
    /// Something that this module's file defines.
    Item(usize),
    External,
}

/// All dependencies between different files, by `use` and by paths in code.
pub(crate) fn edges(modules: &[Module]) -> Vec<Edge> {
    let resolver = Resolver { modules };
    let mut edges: Vec<Edge> = Vec::new();
    for (index, module) in modules.iter().enumerate() {
        let mut add = |to: &Path, line, path: &[String]| {
            if to != module.file {
                edges.push(Edge {
                    from: module.file.clone(),
                    to: to.to_owned(),
                    line,
                    path: path.join("::"),
                });
            }
        };
        for import in module.imports.iter().filter(|it| !it.is_reexport) {
            match resolver.resolve(index, &import.path, 0) {
                Target::Item(defining) => add(&modules[defining].file, import.line, &import.path),
                Target::Module(all) if import.name.is_none() => {
                    add(&modules[all].file, import.line, &import.path);
                }
                // The items of the module are found where code names them.
                Target::Module(_) | Target::External => {}
            }
        }
        for mention in &module.mentions {
            if resolver.begins_with_module(index, &mention.path)
                && let Target::Item(defining) = resolver.resolve(index, &mention.path, 0)
            {
                add(&modules[defining].file, mention.line, &mention.path);
            }
        }
    }
    edges.sort();
    edges.dedup_by(|a, b| a.from == b.from && a.to == b.to);
    edges
}

/// The types of this crate that have `impl` blocks: for each block, the file that defines the type, the type's name,
/// and the file of the block.
pub(crate) fn implementations(modules: &[Module]) -> Vec<(&Path, &str, &Path)> {
    let resolver = Resolver { modules };
    let mut found = Vec::new();
    for (index, module) in modules.iter().enumerate() {
        for path in &module.impls {
            if let Target::Item(defining) = resolver.resolve(index, path, 0)
                && let Some(name) = path.last()
            {
                found.push((&*modules[defining].file, name.as_str(), &*module.file));
            }
        }
    }
    found
}

struct Resolver<'a> {
    modules: &'a [Module],
}

impl Resolver<'_> {
    /// Paths that begin with a type are those of its import.
    fn begins_with_module(&self, from: usize, path: &[String]) -> bool {
        let first = path[0].as_str();
        let is_keyword = ["crate", "self", "super"].contains(&first);
        is_keyword || matches!(self.lookup(from, first, 0), Some(Target::Module(_)))
    }

    fn resolve(&self, from: usize, path: &[String], imports: usize) -> Target {
        if imports > IMPORTS_MAX {
            return Target::External;
        }
        let mut parts = path.iter().map(String::as_str).peekable();
        let mut at = from;
        let mut is_relative = false;
        while let Some(&part) = parts.peek() {
            match part {
                "crate" => at = 0,
                "self" => {}
                "super" => at = self.modules[at].parent,
                _ => break,
            }
            is_relative = true;
            parts.next();
        }
        for part in parts {
            match self.lookup(at, part, imports) {
                Some(Target::Module(inner)) => at = inner,
                Some(found) => return found,
                // A macro made it, or it belongs to another crate.
                None if is_relative => return Target::Item(at),
                None => return Target::External,
            }
            is_relative = true;
        }
        Target::Module(at)
    }

    /// The definition of `name` in this module.
    fn lookup(&self, at: usize, name: &str, imports: usize) -> Option<Target> {
        let module = &self.modules[at];
        if let Some(child) = module.children.get(name) {
            return Some(Target::Module(*child));
        }
        if module.items.contains(name) {
            return Some(Target::Item(at));
        }
        let named = (module.imports.iter()).find(|it| it.name.as_deref() == Some(name));
        if let Some(import) = named {
            return Some(self.resolve(at, &import.path, imports + 1));
        }
        if imports > IMPORTS_MAX {
            return None;
        }
        let globs = module.imports.iter().filter(|it| it.name.is_none());
        let mut found = globs.filter_map(|it| match self.resolve(at, &it.path, imports + 1) {
            Target::Module(all) if all != at => self.lookup(all, name, imports + 1),
            _ => None,
        });
        found.next()
    }
}
