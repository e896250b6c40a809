//! Which module of a crate imports which, and the import cycles.
//!
//! *Module*: here a file; modules inside a file count as that file. *Import*: any path to something that another file
//! defines, in `use`, in code, or in the arguments of a macro or of an attribute. A path is followed through re-exports
//! to the file with the definition; if none is found, as when a macro made it, the module that the path names counts. A
//! call of a type's own function, as `self.f()` or `Self::f()`, is an import of the file whose `impl` of that type has
//! `f`; a call on any other value is not, as its type is not known here. `mod x;` alone imports nothing, nor does `use
//! a::b;` where `b` is a module: the paths through it do.

use crate::{source, tree};
use anyhow::{Context, Result, bail};
use proc_macro2::{Ident, Span, TokenStream, TokenTree};
use quote::ToTokens;
use std::{
    collections::{BTreeMap, BTreeSet, HashMap, HashSet},
    path::{Path, PathBuf},
};
use syn::{
    Attribute, ImplItem, Item, ItemImpl, ItemMacro, ItemMod, ItemUse, UseTree, Visibility,
    ext::IdentExt,
    visit::{self, Visit},
};

/// The import cycles in the crate with this root file: how many modules, each of which imports the next one, and the
/// last one the first; then each import with its line and the two files, by their paths below `base`.
pub fn circles(root: &Path, base: &Path) -> Result<Vec<String>> {
    let modules = Tree::read(root)?;
    let imports = modules.imports();
    let mut reach = vec![BTreeSet::<usize>::new(); modules.files.len()];
    for (from, to) in imports.keys() {
        reach[*from].insert(*to);
    }
    for through in 0..reach.len() {
        let further = reach[through].clone();
        for reached in reach.iter_mut().filter(|reached| reached.contains(&through)) {
            reached.extend(&further);
        }
    }
    let mut circles = Vec::new();
    for (file, reached) in reach.iter().enumerate() {
        let circle: BTreeSet<usize> = reached.iter().copied().filter(|&other| reach[other].contains(&file)).collect();
        // A circle is told once, by its first file; that of a file in none is empty.
        if circle.first() != Some(&file) {
            continue;
        }
        let mut text = format!("{} modules import each other in a circle:", circle.len());
        for ((from, to), paths) in &imports {
            if circle.contains(from) && circle.contains(to) {
                let [from, to] = [from, to].map(|file| tree::below(&modules.files[*file], base));
                let mut lines = BTreeMap::<usize, Vec<&str>>::new();
                paths.iter().for_each(|(path, line)| lines.entry(*line).or_default().push(path));
                for (line, names) in lines {
                    text += &format!("\n    {from}:{line} imports {} from {to}", names.join(", "));
                }
            }
        }
        circles.push(text);
    }
    Ok(circles)
}

/// A crate's modules.
#[derive(Default)]
struct Tree {
    files: Vec<PathBuf>,
    modules: Vec<Module>,
}

#[derive(Default)]
struct Module {
    file: usize,
    parent: Option<usize>,
    names: HashMap<String, Vec<Meaning>>,
    /// The paths that `*` imports.
    globs: Vec<Vec<String>>,
    /// Textual macros, which child modules and later ones see without a path, and their files.
    macros: HashMap<String, usize>,
    /// Functions of types: in an `impl` without a trait, each after the path of the type.
    functions: Vec<Vec<String>>,
    /// The path of the type, while such an `impl` is read.
    of: Option<Vec<String>>,
    written: Vec<Written>,
}

/// What a name means, or where a path leads.
#[derive(PartialEq, Eq, Hash)]
enum Meaning {
    /// An item of this file.
    Item(usize),
    Module(usize),
    /// What the path means, which is never where another one leads.
    Path(Vec<String>),
}

/// A path as it is written.
struct Written {
    path: Vec<String>,
    line: usize,
    place: Place,
}

/// Where a path is written, which decides what it imports.
enum Place {
    /// In code, or in a `use`; `modules`: which imports modules too, because others find them or their contents here.
    Path { modules: bool },
    /// At the call of a textual macro of this file.
    Macro(usize),
    /// At a call of this function of the type whose `impl` it is in.
    Own(Vec<String>),
}

impl Tree {
    fn read(root: &Path) -> Result<Self> {
        let mut tree = Self::default();
        tree.module(root, source::parse(root)?.items, None, Path::new(""))?;
        Ok(tree)
    }

    /// Adds a module of a file; `within`: the names of the modules around it in the same file.
    fn module(&mut self, path: &Path, items: Vec<Item>, parent: Option<usize>, within: &Path) -> Result<usize> {
        let file = self.files.iter().position(|known| known == path).unwrap_or_else(|| {
            self.files.push(path.to_path_buf());
            self.files.len() - 1
        });
        let place = self.modules.len();
        let macros = parent.map(|parent| self.modules[parent].macros.clone()).unwrap_or_default();
        self.modules.push(Module { file, parent, macros, ..Module::default() });
        for item in items {
            match item {
                item if source::only_for_tests(&item) => {}
                Item::Mod(item) => self.child(path, item, place, within)?,
                item => self.modules[place].define(&item)?,
            }
        }
        Ok(place)
    }

    /// Adds a module declared by another one.
    fn child(&mut self, path: &Path, mut item: ItemMod, parent: usize, within: &Path) -> Result<()> {
        let name = bare(&item.ident);
        let child = match item.content.take() {
            Some((_, items)) => self.module(path, items, Some(parent), &within.join(&name))?,
            None => {
                let path = source::module_file(path, within, &item);
                let file = source::parse(&path);
                file.and_then(|file| self.module(&path, file.items, Some(parent), Path::new("")))
                    .with_context(|| format!("module {name}"))?
            }
        };
        if item.attrs.iter().any(|attribute| attribute.path().is_ident("macro_use")) {
            let macros = self.modules[child].macros.clone();
            self.modules[parent].macros.extend(macros);
        }
        self.modules[parent].define_name(name, Meaning::Module(child));
        Ok(())
    }

    /// Imports from file to file, with the paths and their lines.
    fn imports(&self) -> BTreeMap<(usize, usize), BTreeMap<String, usize>> {
        let mut functions = HashMap::new();
        for (at, module) in self.modules.iter().enumerate() {
            let own = module.functions.iter().filter_map(|path| self.function(at, path));
            functions.extend(own.map(|function| (function, module.file)));
        }
        let mut imports = BTreeMap::<_, BTreeMap<_, _>>::new();
        for (at, module) in self.modules.iter().enumerate() {
            for Written { path, line, place } in &module.written {
                let files = match place {
                    // A name from a `use` counts as imported there, unless it is a module that the path leads through.
                    Place::Path { .. } if module.names.contains_key(&path[0]) && !self.is_module(at, &path[..1]) => {
                        continue;
                    }
                    Place::Path { modules } => self.files(at, path, *modules),
                    Place::Macro(file) => vec![*file],
                    Place::Own(function) => {
                        self.function(at, function).and_then(|own| functions.get(&own).copied()).into_iter().collect()
                    }
                };
                for file in files.into_iter().filter(|file| *file != module.file) {
                    imports.entry((module.file, file)).or_default().entry(path.join("::")).or_insert(*line);
                }
            }
        }
        imports
    }

    /// A function of a type by the file of the type and both names.
    fn function<'a>(&self, module: usize, path: &'a [String]) -> Option<(usize, &'a [String])> {
        let names = path.len() - 2;
        Some((*self.files(module, &path[..=names], false).first()?, &path[names..]))
    }

    /// The files of the items that a path leads to; of the modules too if asked.
    fn files(&self, module: usize, path: &[String], modules: bool) -> Vec<usize> {
        let found = self.resolve(module, path, false, &mut HashSet::new());
        let file = |meaning| match meaning {
            Meaning::Item(file) => Some(file),
            Meaning::Module(module) => modules.then(|| self.modules[module].file),
            Meaning::Path(_) => None,
        };
        found.into_iter().filter_map(file).collect()
    }

    fn is_module(&self, module: usize, path: &[String]) -> bool {
        let found = self.resolve(module, path, false, &mut HashSet::new());
        found.iter().any(|meaning| matches!(meaning, Meaning::Module(_)))
    }

    /// Where a path leads from a module; nowhere if it leaves the crate. `anchored`: what no file defines counts as the
    /// module's. `seen`: the names that are being followed.
    fn resolve(
        &self,
        module: usize,
        path: &[String],
        anchored: bool,
        seen: &mut HashSet<(usize, String)>,
    ) -> HashSet<Meaning> {
        let [name, rest @ ..] = path else { return HashSet::from([Meaning::Module(module)]) };
        let here = &self.modules[module];
        let start = match name.as_str() {
            "crate" => Some(0),
            "self" => Some(module),
            "super" => here.parent,
            _ => None,
        };
        if let Some(start) = start {
            return self.resolve(start, rest, true, seen);
        }
        let mut found = HashSet::new();
        if seen.insert((module, name.clone())) {
            if let Some(meanings) = here.names.get(name) {
                let is_module = meanings.iter().any(|meaning| matches!(meaning, Meaning::Module(_)));
                for meaning in meanings {
                    found.extend(match meaning {
                        // A function may have a module's name; a longer path leads through the module.
                        Meaning::Item(_) if is_module && !rest.is_empty() => HashSet::new(),
                        Meaning::Item(file) => HashSet::from([Meaning::Item(*file)]),
                        Meaning::Module(child) => self.resolve(*child, rest, true, seen),
                        Meaning::Path(to) => self.resolve(module, &[to, rest].concat(), false, seen),
                    });
                }
            } else {
                for glob in &here.globs {
                    for meaning in self.resolve(module, glob, false, seen) {
                        if let Meaning::Module(through) = meaning {
                            found.extend(self.resolve(through, path, false, seen));
                        }
                    }
                }
            }
            seen.remove(&(module, name.clone()));
        }
        if found.is_empty() && anchored {
            found.insert(Meaning::Item(here.file));
        }
        found
    }
}

impl Module {
    /// Records what the item defines, and the paths in it.
    fn define(&mut self, item: &Item) -> Result<()> {
        match item {
            Item::Macro(ItemMacro { ident: Some(name), .. }) => {
                self.macros.insert(name.to_string(), self.file);
                self.define_name(bare(name), Meaning::Item(self.file));
            }
            Item::Macro(item) if item.mac.path.is_ident("include") => {
                let line = item.mac.path.segments[0].ident.span().start().line;
                bail!("line {line}: modules from `include!` are not followed; declare them with `mod`");
            }
            // The macro usually defines the items among its arguments.
            Item::Macro(item) => self.define_tokens(item.mac.tokens.clone(), true),
            item => self.define_tokens(item.to_token_stream(), false),
        }
        visit::visit_item(self, item);
        Ok(())
    }

    fn define_name(&mut self, name: String, meaning: Meaning) {
        self.names.entry(name).or_default().push(meaning);
    }

    /// Records the items among tokens; `deep`: those in groups too.
    fn define_tokens(&mut self, tokens: TokenStream, deep: bool) {
        let (mut keyword, mut in_type) = (false, false);
        for token in tokens {
            match token {
                TokenTree::Group(group) if deep => self.define_tokens(group.stream(), deep),
                TokenTree::Ident(ident) => {
                    if keyword {
                        self.define_name(bare(&ident), Meaning::Item(self.file));
                    }
                    let keywords = ["struct", "enum", "union", "trait", "type", "fn", "const", "static"];
                    keyword = !in_type && keywords.iter().any(|word| ident == word);
                    in_type = false;
                }
                // `'static` and `*const` are parts of types.
                TokenTree::Punct(mark) => (keyword, in_type) = (false, matches!(mark.as_char(), '\'' | '*')),
                _ => keyword = false,
            }
        }
    }

    /// Records the names of a `use`; `again`: others find them here too.
    fn define_use(&mut self, tree: &UseTree, before: &[String], again: bool) {
        let (ident, name) = match tree {
            UseTree::Path(path) => return self.define_use(&path.tree, &joined(before, &path.ident), again),
            UseTree::Group(group) => return group.items.iter().for_each(|tree| self.define_use(tree, before, again)),
            UseTree::Glob(glob) => {
                self.globs.push(before.to_vec());
                return self.write(before.to_vec(), glob.star_token.spans[0], Place::Path { modules: true });
            }
            UseTree::Name(name) => (&name.ident, &name.ident),
            UseTree::Rename(rename) => (&rename.ident, &rename.rename),
        };
        // `a::{self}` is `a`.
        let path = if ident == "self" && !before.is_empty() { before.to_vec() } else { joined(before, ident) };
        let name = path.last().filter(|_| name == "self").cloned().unwrap_or_else(|| bare(name));
        // A name that refers to itself is needed to give a macro a path.
        if path != [name.as_str()] {
            self.define_name(name, Meaning::Path(path.clone()));
        }
        self.write(path, ident.span(), Place::Path { modules: again });
    }

    fn write(&mut self, path: Vec<String>, span: Span, place: Place) {
        self.written.push(Written { path, line: span.start().line, place });
    }

    /// A call of the own function of this `impl`'s type.
    fn call(&mut self, name: &Ident) {
        if let Some(of) = &self.of {
            let function = joined(of, name);
            self.write(vec!["Self".into(), bare(name)], name.span(), Place::Own(function));
        }
    }

    /// The paths among tokens; `texts`: in strings too, as attributes contain them.
    fn tokens(&mut self, tokens: TokenStream, texts: bool) {
        // Punctuation marks since the last other token, and whether that one is the end of a path.
        let (mut marks, mut in_path) = (String::new(), false);
        for token in tokens {
            match token {
                TokenTree::Punct(mark) => {
                    marks.push(mark.as_char());
                    continue;
                }
                TokenTree::Ident(name) => {
                    let goes_on = in_path && marks == "::";
                    // After one dot it is a field or method, after `::` a name of another crate or of a type.
                    let is_member = marks.ends_with("::") || (marks.ends_with('.') && !marks.ends_with(".."));
                    in_path = goes_on || !is_member;
                    if goes_on && let Some(written) = self.written.last_mut() {
                        written.path.push(bare(&name));
                    } else if in_path {
                        self.write(vec![bare(&name)], name.span(), Place::Path { modules: false });
                    }
                }
                TokenTree::Group(group) => {
                    in_path = false;
                    self.tokens(group.stream(), texts);
                }
                TokenTree::Literal(literal) => {
                    in_path = false;
                    // Prose is not a path.
                    if let (true, syn::Lit::Str(text)) = (texts, syn::Lit::new(literal))
                        && text.value().contains("::")
                    {
                        self.tokens(text.value().parse().unwrap_or_default(), false);
                    }
                }
            }
            marks.clear();
        }
    }
}

/// A name without `r#`.
fn bare(name: &Ident) -> String {
    name.unraw().to_string()
}

fn joined(before: &[String], name: &Ident) -> Vec<String> {
    [before, &[bare(name)]].concat()
}

fn names(path: &syn::Path) -> Vec<String> {
    path.segments.iter().map(|segment| bare(&segment.ident)).collect()
}

/// Records the paths of an item, except in what is for tests only.
impl<'ast> Visit<'ast> for Module {
    fn visit_item(&mut self, item: &'ast Item) {
        if !source::only_for_tests(item) {
            visit::visit_item(self, item);
        }
    }

    fn visit_impl_item(&mut self, item: &'ast ImplItem) {
        if source::only_for_tests(item) {
            return;
        }
        if let (ImplItem::Fn(function), Some(of)) = (item, &self.of) {
            self.functions.push(joined(of, &function.sig.ident));
        }
        visit::visit_impl_item(self, item);
    }

    fn visit_item_impl(&mut self, item: &'ast ItemImpl) {
        if let (None, syn::Type::Path(of)) = (&item.trait_, &*item.self_ty) {
            self.of = Some(names(&of.path));
        }
        visit::visit_item_impl(self, item);
        self.of = None;
    }

    fn visit_expr_method_call(&mut self, call: &'ast syn::ExprMethodCall) {
        if matches!(&*call.receiver, syn::Expr::Path(path) if path.path.is_ident("self")) {
            self.call(&call.method);
        }
        visit::visit_expr_method_call(self, call);
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        // A leading `::` names another crate.
        if item.leading_colon.is_none() {
            self.define_use(&item.tree, &[], !matches!(item.vis, Visibility::Inherited));
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if let (None, Some(first)) = (&path.leading_colon, path.segments.first()) {
            match path.segments.get(1) {
                Some(second) if first.ident == "Self" => self.call(&second.ident),
                _ => self.write(names(path), first.ident.span(), Place::Path { modules: false }),
            }
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, called: &'ast syn::Macro) {
        match called.path.get_ident() {
            Some(name) => {
                if let Some(&file) = self.macros.get(&name.to_string()) {
                    self.write(vec![name.to_string()], name.span(), Place::Macro(file));
                }
            }
            None => self.visit_path(&called.path),
        }
        self.tokens(called.tokens.clone(), false);
    }

    fn visit_attribute(&mut self, attribute: &'ast Attribute) {
        if let (syn::Meta::List(list), false) = (&attribute.meta, attribute.path().is_ident("cfg")) {
            self.tokens(list.tokens.clone(), true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;

    /// The imports of a crate of these files as `file:line path file`.
    fn imports(files: &[(&str, &str)]) -> Vec<String> {
        let fixture = Fixture::new(files);
        let tree = Tree::read(&fixture.0.join(files[0].0)).unwrap();
        let name = |file: &usize| tree.files[*file].strip_prefix(&fixture.0).unwrap().display().to_string();
        let mut found = Vec::new();
        for ((from, to), paths) in tree.imports() {
            found.extend(paths.iter().map(|(path, line)| format!("{}:{line} {path} {}", name(&from), name(&to))));
        }
        found
    }

    /// The imports of module `a`, beside module `b` and its child `c`.
    fn of_a(text: &str) -> Vec<String> {
        let b = "pub mod c; pub struct B; pub enum E { One } pub fn f() {}";
        imports(&[("lib.rs", "mod a; mod b;"), ("a.rs", text), ("b.rs", b), ("b/c.rs", "pub struct C; pub fn g() {}")])
    }

    #[test]
    fn a_use_is_an_import_of_what_it_names() {
        for (text, import) in [
            ("use crate::b::B;", "a.rs:1 crate::b::B b.rs"),
            ("use crate::b::E::*;", "a.rs:1 crate::b::E b.rs"),
            ("use crate::b::*;", "a.rs:1 crate::b b.rs"),
            ("fn f() {\n use crate::b::B as Other;\n}", "a.rs:2 crate::b::B b.rs"),
        ] {
            assert_eq!(of_a(text), [import], "{text}");
        }
        assert_eq!(of_a("use super::b::{B, c::C};"), ["a.rs:1 super::b::B b.rs", "a.rs:1 super::b::c::C b/c.rs"]);
        assert!(of_a("use std::fmt; use serde::b::B; use ::b::B;").is_empty());
    }

    #[test]
    fn a_module_that_is_named_alone_is_no_import_but_the_paths_through_it_are() {
        assert!(of_a("use crate::b;").is_empty());
        assert_eq!(of_a("use crate::b;\nfn f() { b::c::g() }"), ["a.rs:2 b::c::g b/c.rs"]);
        let both = [
            ("lib.rs", "mod a; mod b;"),
            ("a.rs", "pub fn c() {} mod c;"),
            ("a/c.rs", "pub struct C;"),
            ("b.rs", "use crate::a::c::C;"),
        ];
        assert_eq!(imports(&both), ["b.rs:1 crate::a::c::C a/c.rs"]);
        assert_eq!(of_a("use crate::b::{self as other};\nfn f() { other::f() }"), ["a.rs:2 other::f b.rs"]);
        assert_eq!(of_a("pub use crate::b;"), ["a.rs:1 crate::b b.rs"]);
        assert_eq!(of_a("fn f() {\n use crate::b;\n b::f() }"), ["a.rs:3 b::f b.rs"]);
    }

    #[test]
    fn inline_paths_are_imports() {
        for (text, import) in [
            ("fn f() { crate::b::f() }", "a.rs:1 crate::b::f b.rs"),
            ("fn f(c: &Vec<super::b::c::C>) {}", "a.rs:1 super::b::c::C b/c.rs"),
            ("impl crate::b::B { fn more(&self) {} }", "a.rs:1 crate::b::B b.rs"),
            ("struct A; impl From<A> for crate::b::B {}", "a.rs:1 crate::b::B b.rs"),
        ] {
            assert_eq!(of_a(text), [import], "{text}");
        }
        assert!(of_a("fn f() { ::b::f(); T::b::f(); }").is_empty());
    }

    #[test]
    fn what_a_type_calls_of_itself_is_an_import_of_the_file_that_has_it() {
        let files = |call: &'static str| {
            [
                ("lib.rs", "mod a; mod b; mod c;"),
                ("a.rs", call),
                ("b.rs", "use crate::c::C; impl C { pub fn f(&self) {} } impl Clone for C { fn g(&self) {} }"),
                ("c.rs", "pub struct C; pub struct D;"),
            ]
        };
        let of_a = |call| imports(&files(call)).into_iter().filter(|one| one.starts_with("a.rs")).collect::<Vec<_>>();
        let c = "a.rs:1 crate::c::C c.rs".to_owned();
        let found = of_a("use crate::c::C;\nimpl C { fn h(&self) { self.f() } }");
        assert_eq!(found, ["a.rs:2 Self::f b.rs".into(), c.clone()]);
        let found = of_a("use crate::c::C as E; impl Copy for E {}\nimpl crate::c::C { fn h(c: &C) { Self::f(c) } }");
        assert!(found.contains(&"a.rs:2 Self::f b.rs".into()), "{found:?}");
        // Of another type, of another value, and of a trait.
        assert!(!of_a("impl crate::c::D { fn h(&self) { self.f() } }").iter().any(|one| one.ends_with("b.rs")));
        assert_eq!(of_a("use crate::c::C; impl C { fn h(&self, c: C) { c.f(); self.g() } }"), [c]);
    }

    #[test]
    fn paths_in_the_arguments_of_macros_and_attributes_are_imports() {
        assert_eq!(of_a("fn f() { println!(\"{}\", [crate::b::f()]) }"), ["a.rs:1 crate::b::f b.rs"]);
        assert_eq!(of_a("#[with(crate::b::f)] struct A;"), ["a.rs:1 crate::b::f b.rs"]);
        assert_eq!(of_a("#[with(\"super::b::f\")] struct A;"), ["a.rs:1 super::b::f b.rs"]);
        assert!(of_a("fn f() { m!(x.crate, ::b::f, \"crate::b::f\") }").is_empty());
        assert!(of_a("/// See crate::b::f and super::b::B.\nfn f() {}").is_empty());
    }

    #[test]
    fn textual_macros_are_imports_of_where_they_are_defined() {
        let definition = "macro_rules! m { () => {} }";
        let files = [("lib.rs", "#[macro_use] mod a; mod b;"), ("a.rs", definition), ("b.rs", "fn f() { m!() }")];
        assert_eq!(imports(&files), ["b.rs:1 m a.rs"]);
        let above = [("lib.rs", "macro_rules! m { () => {} }\nmod b;"), ("b.rs", "fn f() { m!() }")];
        assert_eq!(imports(&above), ["b.rs:1 m lib.rs"]);
        let exported = [
            ("lib.rs", "mod a; mod b;"),
            ("a.rs", "macro_rules! m { () => {} }\npub(crate) use m;"),
            ("b.rs", "fn f() { crate::a::m!() }"),
        ];
        assert_eq!(imports(&exported), ["b.rs:1 crate::a::m a.rs"]);
    }

    #[test]
    fn a_path_is_followed_through_re_exports_to_the_definition() {
        let lib = "mod a; mod b; mod c;\npub use b::B;";
        let files = [
            ("lib.rs", lib),
            ("a.rs", "use crate::B;\nuse crate::c::{C, D};"),
            ("b.rs", "pub struct B;"),
            ("c.rs", "pub use crate::b::B as C;\npub use crate::b::*;"),
        ];
        let found = imports(&files);
        assert!(found.contains(&"a.rs:1 crate::B b.rs".into()), "{found:?}");
        assert!(found.contains(&"a.rs:2 crate::c::C b.rs".into()), "{found:?}");
        // No file defines it, so the module that the path names counts.
        assert!(found.contains(&"a.rs:2 crate::c::D c.rs".into()), "{found:?}");
        assert!(!found.iter().any(|import| import.starts_with("a.rs") && import.ends_with("lib.rs")), "{found:?}");
    }

    #[test]
    fn names_that_come_by_a_star_are_imports_of_where_they_are_defined() {
        let files = [
            ("lib.rs", "mod a; mod b; mod c;"),
            ("a.rs", "use crate::c::*;\nfn f() { g() }"),
            ("b.rs", "pub fn g() {}"),
            ("c.rs", "pub use crate::b::g;"),
        ];
        assert_eq!(imports(&files), ["a.rs:2 g b.rs", "a.rs:1 crate::c c.rs", "c.rs:1 crate::b::g b.rs"]);
    }

    #[test]
    fn what_a_macro_makes_is_defined_where_the_macro_is_called() {
        let files = [
            ("lib.rs", "mod a; mod b;\npub use b::*;"),
            ("a.rs", "use crate::Made;"),
            ("b.rs", "make! { pub struct Made { } }"),
        ];
        assert!(imports(&files).contains(&"a.rs:1 crate::Made b.rs".into()));
    }

    #[test]
    fn a_parent_that_re_exports_and_a_child_that_takes_from_it_are_a_circle() {
        let files =
            [("lib.rs", "mod child;\npub use child::C;\npub struct P;"), ("child.rs", "pub struct C(super::P);")];
        assert_eq!(imports(&files), ["lib.rs:2 child::C child.rs", "child.rs:1 super::P lib.rs"]);
        let alone = [("lib.rs", "mod child;\npub struct P;"), ("child.rs", "pub struct C(super::P);")];
        assert_eq!(imports(&alone), ["child.rs:1 super::P lib.rs"]);
    }

    #[test]
    fn tests_are_left_aside() {
        for text in [
            "#[cfg(test)] mod tests { use crate::b::B; }",
            "#[cfg(test)] mod not_there;",
            "struct A; impl A { #[cfg(test)] fn f() { crate::b::f() } }",
            "#[cfg(test)] use crate::b::B;",
            "fn f() { #[cfg(test)] fn g() { crate::b::f() } }",
        ] {
            assert!(of_a(text).is_empty(), "{text}");
        }
        assert_eq!(of_a("#[cfg(unix)] use crate::b::B;").len(), 1);
    }

    #[test]
    fn modules_are_found_wherever_their_files_lie() {
        let files = [
            ("src/main.rs", "mod a; mod inner { pub mod deep; }\n#[path = \"boards/one.rs\"] mod board;"),
            ("src/a/mod.rs", "mod b; use crate::inner::deep::D; use crate::board::X;"),
            ("src/a/b.rs", "use super::super::board::X;"),
            ("src/inner/deep.rs", "pub struct D;"),
            ("src/boards/one.rs", "mod pins; pub struct X(pins::P);"),
            ("src/boards/pins.rs", "pub struct P;"),
        ];
        let mut found: Vec<_> =
            imports(&files).into_iter().filter_map(|one| Some(one.rsplit_once(' ')?.1.to_owned())).collect();
        found.sort();
        assert_eq!(found, ["src/boards/one.rs", "src/boards/one.rs", "src/boards/pins.rs", "src/inner/deep.rs"]);
    }

    #[test]
    fn modules_within_a_file_are_the_file() {
        assert_eq!(
            of_a("mod x { use crate::b::B; pub struct X; }\nuse x::X; mod y { use super::X; }"),
            ["a.rs:1 crate::b::B b.rs"]
        );
    }

    #[test]
    fn another_crate_of_a_modules_name_is_no_import() {
        let of_root = |text: &str| imports(&[("lib.rs", text), ("b.rs", "pub fn f() {}")]);
        assert!(of_root("mod b; use ::b::f;").is_empty());
        assert!(of_root("mod b; fn g() { m!(::b::f, <T>::b::f, x.b::f) }").is_empty());
        assert_eq!(of_root("mod b; fn g() { m!(0..b::f()) }"), ["lib.rs:1 b::f b.rs"]);
    }

    #[test]
    fn an_include_is_refused() {
        let error = Module::default().define(&syn::parse_quote!(include!("more.rs");)).unwrap_err();
        assert!(error.to_string().contains("`include!`"));
    }
}
