//! Shapes of types: flags of a structure, and files that implement a type.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use syn::{
    Attribute, Field, ItemStruct, Meta, Type,
    visit::{self, Visit},
};

use super::{edges, modules::Module};

const BOOLS_MAX: usize = 3;
const IMPL_FILES_MAX: usize = 6;

/// A type that breaks a rule.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Misshapen {
    pub(crate) name: String,
    /// How many flags or files it has.
    pub(crate) count: usize,
    pub(crate) text: String,
}

/// Structures of a file with too many `bool` fields. One alone of these has a meaning in few combinations. Options of a
/// command line do not count: each is a flag of its own.
pub(crate) fn many_flags(path: &Path, text: &str) -> Vec<Misshapen> {
    if text.matches("bool").count() <= BOOLS_MAX {
        return Vec::new();
    }
    let parsed = syn::parse_file(text);
    let parsed = parsed.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut visitor = Structs {
        path,
        found: Vec::new(),
    };
    visitor.visit_file(&parsed);
    visitor.found
}

struct Structs<'a> {
    path: &'a Path,
    found: Vec<Misshapen>,
}

impl<'ast> Visit<'ast> for Structs<'_> {
    fn visit_item_struct(&mut self, it: &'ast ItemStruct) {
        let count = it.fields.iter().filter(|it| is_bool(it)).count();
        if count > BOOLS_MAX && !it.attrs.iter().any(derives_options) {
            let name = it.ident.to_string();
            let (path, line) = (self.path.display(), it.ident.span().start().line);
            let text = format!("{path}:{line}: {name} has {count} bools ({BOOLS_MAX} at most)");
            self.found.push(Misshapen { name, count, text });
        }
        visit::visit_item_struct(self, it);
    }
}

fn is_bool(field: &Field) -> bool {
    matches!(&field.ty, Type::Path(it) if it.path.is_ident("bool"))
}

/// `#[derive(Args)]` or `#[derive(Parser)]`.
fn derives_options(attribute: &Attribute) -> bool {
    let Meta::List(list) = &attribute.meta else {
        return false;
    };
    let derived = list.tokens.to_string();
    let mut derived = derived.split(|c: char| !c.is_alphanumeric());
    list.path.is_ident("derive") && derived.any(|it| ["Args", "Parser"].contains(&it))
}

/// Types of a crate whose `impl` blocks are in too many files.
pub(crate) fn scattered_types(modules: &[Module]) -> Vec<Misshapen> {
    let mut types: BTreeMap<_, BTreeSet<_>> = BTreeMap::new();
    for (defined, name, file) in edges::implementations(modules) {
        types.entry((defined, name)).or_default().insert(file);
    }
    let mut found = Vec::new();
    for ((defined, name), files) in types {
        let count = files.len();
        if count > IMPL_FILES_MAX {
            let files: Vec<_> = files.iter().map(|it| it.display().to_string()).collect();
            let (defined, files) = (defined.display(), files.join(", "));
            let text = format!(
                "{name} of {defined} has impl blocks in {count} files ({IMPL_FILES_MAX} at most): {files}"
            );
            let name = name.to_owned();
            found.push(Misshapen { name, count, text });
        }
    }
    found
}
