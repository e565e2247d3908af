//! The tree of modules of a crate: which items each defines, imports and names by paths.
//!
//! Items with `#[cfg(test)]` or `#[cfg(kani)]`, and all below them, are left out.

use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
};

use proc_macro2::{TokenStream, TokenTree};
use syn::{
    Attribute, Item, ItemMod, ItemUse, Meta, Type, UseTree, Visibility,
    spanned::Spanned,
    visit::{self, Visit},
};

use super::sources::Sources;

/// One `use` of one name, or of all names of a module.
#[derive(Debug)]
pub(crate) struct Import {
    /// The name that it has here; `None` for `*`.
    pub(crate) name: Option<String>,
    pub(crate) path: Vec<String>,
    pub(crate) line: usize,
    pub(crate) is_reexport: bool,
}

/// A path of two or more parts in code.
#[derive(Debug)]
pub(crate) struct Mention {
    pub(crate) path: Vec<String>,
    pub(crate) line: usize,
}

/// A module, in a file of its own or in that of its parent.
#[derive(Debug, Default)]
pub(crate) struct Module {
    pub(crate) file: PathBuf,
    pub(crate) parent: usize,
    pub(crate) children: HashMap<String, usize>,
    pub(crate) items: HashSet<String>,
    pub(crate) imports: Vec<Import>,
    pub(crate) mentions: Vec<Mention>,
    /// The paths of the types that `impl` blocks are of.
    pub(crate) impls: Vec<Vec<String>>,
}

/// All modules of the crate with this root file; the root comes first.
pub(crate) fn read_crate(sources: &Sources, root: &Path) -> Vec<Module> {
    let mut reader = Reader {
        sources,
        modules: Vec::new(),
        current: 0,
        folder: root.parent().unwrap_or(Path::new("")).to_owned(),
        exported_macros: Vec::new(),
    };
    reader.read_file(root);
    reader.export_macros();
    reader.modules
}

struct Reader<'a> {
    sources: &'a Sources,
    modules: Vec<Module>,
    current: usize,
    /// Where the files of the current module's children are.
    folder: PathBuf,
    /// `#[macro_export]`: defined in this module, but named by the crate's root.
    exported_macros: Vec<(usize, String)>,
}

impl Reader<'_> {
    /// Reads a file whose items belong to a new module, and returns that module's index.
    fn read_file(&mut self, path: &Path) -> usize {
        let text = self.sources.get(path).expect("a file that was found");
        let parsed = syn::parse_file(text);
        let parsed = parsed.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        self.read_module(path.to_owned(), &parsed.items)
    }

    fn read_module(&mut self, file: PathBuf, items: &[Item]) -> usize {
        let index = self.modules.len();
        let parent = self.current;
        self.modules.push(Module {
            file,
            parent,
            ..Module::default()
        });
        self.current = index;
        for item in items {
            self.visit_item(item);
        }
        self.current = parent;
        index
    }

    fn read_child(&mut self, child: &ItemMod) {
        let name = child.ident.to_string();
        let parent_folder = self.folder.clone();
        let index = if let Some((_, items)) = &child.content {
            self.folder = parent_folder.join(&name);
            let file = self.modules[self.current].file.clone();
            self.read_module(file, items)
        } else {
            let Some(file) = self.find_file(child, &name) else {
                return;
            };
            let is_folder = file.ends_with("mod.rs") || path_attribute(&child.attrs).is_some();
            let beside = file.parent().expect("it is in a folder").to_owned();
            self.folder = if is_folder {
                beside
            } else {
                beside.join(&name)
            };
            self.read_file(&file)
        };
        self.folder = parent_folder;
        self.modules[self.current].children.insert(name, index);
    }

    fn find_file(&self, child: &ItemMod, name: &str) -> Option<PathBuf> {
        let candidates = if let Some(path) = path_attribute(&child.attrs) {
            let beside = self.modules[self.current].file.parent()?;
            vec![beside.join(path)]
        } else {
            let plain = self.folder.join(format!("{name}.rs"));
            vec![plain, self.folder.join(name).join("mod.rs")]
        };
        let mut found = candidates.into_iter();
        found.find(|it| self.sources.get(it).is_some())
    }

    fn export_macros(&mut self) {
        for (module, name) in std::mem::take(&mut self.exported_macros) {
            let child = self.modules.len();
            let file = self.modules[module].file.clone();
            // An import of the root, as if from a module that holds the macro alone.
            self.modules.push(Module {
                file,
                items: HashSet::from([name.clone()]),
                ..Module::default()
            });
            let hidden = format!("macro {name}");
            self.modules[0].children.insert(hidden.clone(), child);
            self.modules[0].imports.push(Import {
                name: Some(name.clone()),
                path: vec!["crate".to_owned(), hidden, name],
                line: 1,
                is_reexport: true,
            });
        }
    }

    fn import(&mut self, item: &ItemUse) {
        let mut flat = Vec::new();
        let mut prefix = Vec::new();
        if item.leading_colon.is_some() {
            return;
        }
        flatten(&item.tree, &mut prefix, &mut flat);
        let is_reexport = !matches!(item.vis, Visibility::Inherited);
        let imports = flat.into_iter().map(|(name, path, line)| Import {
            name,
            path,
            line,
            is_reexport,
        });
        self.modules[self.current].imports.extend(imports);
    }

    fn mention(&mut self, path: Vec<String>, line: usize) {
        if path.len() > 1 {
            self.modules[self.current]
                .mentions
                .push(Mention { path, line });
        }
    }

    /// Notes the paths in the tokens of a macro's call, which have no syntax of their own.
    fn mentions_in(&mut self, tokens: TokenStream) {
        let mut path: Vec<String> = Vec::new();
        let mut line = 0;
        let mut colons = 0;
        for token in tokens {
            match token {
                TokenTree::Ident(ident) => {
                    if colons != 2 {
                        self.mention(std::mem::take(&mut path), line);
                    }
                    line = ident.span().start().line;
                    path.push(ident.to_string());
                    colons = 0;
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' && !path.is_empty() => {
                    colons += 1;
                }
                TokenTree::Group(group) => {
                    self.mention(std::mem::take(&mut path), line);
                    self.mentions_in(group.stream());
                }
                TokenTree::Punct(_) | TokenTree::Literal(_) => {
                    self.mention(std::mem::take(&mut path), line);
                    colons = 0;
                }
            }
        }
        self.mention(path, line);
    }
}

impl<'ast> Visit<'ast> for Reader<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        if is_only_for_checks(attributes(item)) {
            return;
        }
        if let Some(name) = defined_name(item) {
            if let Item::Macro(it) = item
                && it.attrs.iter().any(|it| it.path().is_ident("macro_export"))
            {
                self.exported_macros.push((self.current, name.clone()));
            }
            self.modules[self.current].items.insert(name);
        }
        match item {
            Item::Mod(child) => self.read_child(child),
            Item::Use(it) => self.import(it),
            Item::Impl(it) => {
                if let Some(path) = path_of(&it.self_ty) {
                    self.modules[self.current].impls.push(path);
                }
                visit::visit_item(self, item);
            }
            other => visit::visit_item(self, other),
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if path.leading_colon.is_none() {
            let parts = path.segments.iter().map(|it| it.ident.to_string());
            self.mention(parts.collect(), path.span().start().line);
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.mentions_in(call.tokens.clone());
        visit::visit_macro(self, call);
    }

    fn visit_attribute(&mut self, _: &'ast Attribute) {}

    fn visit_visibility(&mut self, _: &'ast Visibility) {}
}

type FlatUse = (Option<String>, Vec<String>, usize);

fn flatten(tree: &UseTree, prefix: &mut Vec<String>, flat: &mut Vec<FlatUse>) {
    let line = tree.span().start().line;
    let full = |last: String| {
        let mut path = prefix.clone();
        if last != "self" {
            path.push(last);
        }
        path
    };
    match tree {
        UseTree::Path(it) => {
            prefix.push(it.ident.to_string());
            flatten(&it.tree, prefix, flat);
            prefix.pop();
        }
        UseTree::Name(it) => {
            let path = full(it.ident.to_string());
            flat.push((path.last().cloned(), path, line));
        }
        UseTree::Rename(it) => {
            let name = it.rename.to_string();
            flat.push((Some(name), full(it.ident.to_string()), line));
        }
        UseTree::Glob(_) => flat.push((None, prefix.clone(), line)),
        UseTree::Group(it) => {
            for inner in &it.items {
                flatten(inner, prefix, flat);
            }
        }
    }
}

/// The path of a type, if it has one.
fn path_of(of: &Type) -> Option<Vec<String>> {
    match of {
        Type::Path(it) if it.qself.is_none() => {
            let parts = it.path.segments.iter().map(|it| it.ident.to_string());
            Some(parts.collect())
        }
        _ => None,
    }
}

/// The text of `#[path = "..."]`.
fn path_attribute(attributes: &[Attribute]) -> Option<String> {
    let attribute = attributes.iter().find(|it| it.path().is_ident("path"))?;
    let Meta::NameValue(pair) = &attribute.meta else {
        return None;
    };
    let syn::Expr::Lit(literal) = &pair.value else {
        return None;
    };
    match &literal.lit {
        syn::Lit::Str(text) => Some(text.value()),
        _ => None,
    }
}

/// Whether a `cfg` compiles the item only for unit tests or for proofs.
fn is_only_for_checks(attributes: &[Attribute]) -> bool {
    let is_check = |attribute: &Attribute| {
        let Meta::List(list) = &attribute.meta else {
            return false;
        };
        attribute.path().is_ident("cfg") && names_check(list.tokens.clone())
    };
    attributes.iter().any(is_check)
}

fn names_check(tokens: TokenStream) -> bool {
    let mut after_not = false;
    for token in tokens {
        match token {
            TokenTree::Ident(ident) if ident == "test" || ident == "kani" => return true,
            TokenTree::Ident(ident) => after_not = ident == "not",
            TokenTree::Group(group) if !after_not && names_check(group.stream()) => return true,
            _ => {}
        }
    }
    false
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(it) => &it.attrs,
        Item::Enum(it) => &it.attrs,
        Item::Fn(it) => &it.attrs,
        Item::Impl(it) => &it.attrs,
        Item::Macro(it) => &it.attrs,
        Item::Mod(it) => &it.attrs,
        Item::Static(it) => &it.attrs,
        Item::Struct(it) => &it.attrs,
        Item::Trait(it) => &it.attrs,
        Item::Type(it) => &it.attrs,
        Item::Union(it) => &it.attrs,
        Item::Use(it) => &it.attrs,
        _ => &[],
    }
}

fn defined_name(item: &Item) -> Option<String> {
    let ident = match item {
        Item::Const(it) => &it.ident,
        Item::Enum(it) => &it.ident,
        Item::Fn(it) => &it.sig.ident,
        Item::Macro(it) => it.ident.as_ref()?,
        Item::Static(it) => &it.ident,
        Item::Struct(it) => &it.ident,
        Item::Trait(it) => &it.ident,
        Item::Type(it) => &it.ident,
        Item::Union(it) => &it.ident,
        _ => return None,
    };
    Some(ident.to_string())
}
