//! Which module of a crate imports which, and the import cycles.
//!
//! *Module*: here a file; modules inside a file count as that file. *Import*: any path to something that another file
//! defines, in `use`, in code, or in the arguments of a macro or of an attribute. A path is followed through re-exports
//! to the file with the definition; if none is found, as when a macro made it, the module that the path names counts. A
//! call of a type's own function, as `self.f()` or `Self::f()`, is an import of the file whose `impl` of that type has
//! `f`; a call on any other value is not, as its type is not known here. `mod x;` alone imports nothing, nor does `use
//! a::b;` where `b` is a module: the paths through it do.

use crate::source::{self, is_mark};
use anyhow::{Context, Result, bail};
use proc_macro2::{Ident, Span, TokenStream, TokenTree};
use std::{
    collections::{BTreeMap, BTreeSet, HashMap, HashSet},
    iter,
    path::{Path, PathBuf},
};
use syn::{
    Attribute, ImplItem, Item, ItemImpl, ItemMacro, ItemMod, ItemUse, UseTree, Visibility,
    ext::IdentExt,
    visit::{self, Visit},
};

/// An import cycle: modules each of which imports the next one, and the last one the first.
pub struct Circle {
    /// How many modules.
    pub modules: usize,
    /// Its imports: file and line, what is imported, and the file that has it.
    pub imports: Vec<Import>,
}

/// A file's imports from another one.
pub struct Import {
    /// The importing file.
    pub from: PathBuf,
    /// The imported file.
    pub to: PathBuf,
    /// The paths as they are written, each with its first line.
    pub paths: BTreeMap<String, usize>,
}

/// The import cycles in the crate with this root file.
pub fn circles(root: &Path) -> Result<Vec<Circle>> {
    let tree = Tree::read(root)?;
    let imports = tree.imports();
    let next = |file: usize| imports.keys().filter(move |(from, _)| *from == file).map(|(_, to)| *to);
    let reach: Vec<HashSet<usize>> = (0..tree.files.len())
        .map(|file| {
            let mut reached = HashSet::new();
            let mut left: Vec<usize> = next(file).collect();
            while let Some(file) = left.pop() {
                if reached.insert(file) {
                    left.extend(next(file));
                }
            }
            reached
        })
        .collect();
    let mut circles = Vec::new();
    for (file, reached) in reach.iter().enumerate() {
        let circle: BTreeSet<usize> = reached.iter().copied().filter(|&other| reach[other].contains(&file)).collect();
        // A circle is told once, by its first file; that of a file in none is empty.
        if circle.first() != Some(&file) {
            continue;
        }
        let within = imports.iter().filter(|((from, to), _)| circle.contains(from) && circle.contains(to));
        circles.push(Circle {
            modules: circle.len(),
            imports: within
                .map(|((from, to), paths)| Import {
                    from: tree.files[*from].clone(),
                    to: tree.files[*to].clone(),
                    paths: paths.clone(),
                })
                .collect(),
        });
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
    names: HashMap<String, Vec<Definition>>,
    /// The paths that `*` imports.
    globs: Vec<Vec<String>>,
    /// Textual macros, which child modules and later ones see without a path.
    macros: HashSet<String>,
    /// `#[macro_use]`: its textual macros are its parent's too.
    macro_use: bool,
    items: Vec<Item>,
}

/// What a name means.
enum Definition {
    Item,
    Module(usize),
    Path(Vec<String>),
}

/// What a path leads to.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Target {
    Item(usize),
    Module(usize),
}

/// A type of the crate, by the file that defines it.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Type {
    file: usize,
    name: String,
}

/// Folders in which a module's files are looked for: those without a `#[path]`, and those with one.
struct Folders {
    own: PathBuf,
    given: PathBuf,
}

impl Tree {
    fn read(root: &Path) -> Result<Self> {
        let mut tree = Self::default();
        tree.file(root, None, None)?;
        Ok(tree)
    }

    /// Adds the module of a file; the files of its modules lie in the folder `own`, or beside it if there is none.
    fn file(&mut self, path: &Path, parent: Option<usize>, own: Option<PathBuf>) -> Result<usize> {
        let parsed = source::parse(path)?;
        let file = self.files.iter().position(|known| known == path).unwrap_or_else(|| {
            self.files.push(path.to_path_buf());
            self.files.len() - 1
        });
        let given = path.parent().unwrap_or(Path::new("")).to_path_buf();
        self.module(parsed.items, file, parent, &Folders { own: own.unwrap_or_else(|| given.clone()), given })
    }

    fn module(&mut self, items: Vec<Item>, file: usize, parent: Option<usize>, folders: &Folders) -> Result<usize> {
        let place = self.modules.len();
        self.modules.push(Module { file, parent, ..Module::default() });
        for item in items {
            if source::only_for_tests(source::attributes(&item)) {
                continue;
            }
            match item {
                Item::Mod(item) => self.child(place, item, folders)?,
                item => {
                    self.modules[place].define(&item)?;
                    self.modules[place].items.push(item);
                }
            }
        }
        Ok(place)
    }

    /// Adds a module declared by another one.
    fn child(&mut self, parent: usize, mut item: ItemMod, folders: &Folders) -> Result<()> {
        let (name, file) = (bare(&item.ident), self.modules[parent].file);
        let child = match item.content.take() {
            Some((_, items)) => {
                let folder = folders.own.join(&name);
                self.module(items, file, Some(parent), &Folders { own: folder.clone(), given: folder })?
            }
            None => {
                let (path, own) = match source::path_attribute(&item.attrs) {
                    Some(path) => (folders.given.join(path), None),
                    None => {
                        let own = folders.own.join(&name);
                        let beside = own.with_extension("rs");
                        (if beside.is_file() { beside } else { own.join("mod.rs") }, Some(own))
                    }
                };
                self.file(&path, Some(parent), own).with_context(|| format!("module {name}"))?
            }
        };
        self.modules[child].macro_use = item.attrs.iter().any(|attribute| attribute.path().is_ident("macro_use"));
        self.modules[parent].names.entry(name).or_default().push(Definition::Module(child));
        Ok(())
    }

    /// Imports from file to file, with the paths and their lines.
    fn imports(&self) -> BTreeMap<(usize, usize), BTreeMap<String, usize>> {
        let mut imports = BTreeMap::<_, BTreeMap<String, usize>>::new();
        let own = self.own();
        for (place, module) in self.modules.iter().enumerate() {
            let mut paths = Paths { tree: self, own: &own, module: place, of: None, found: Vec::new() };
            module.items.iter().for_each(|item| paths.visit_item(item));
            for (file, path, line) in paths.found {
                if file != module.file {
                    imports.entry((module.file, file)).or_default().entry(path).or_insert(line);
                }
            }
        }
        imports
    }

    /// Which file's `impl` has each function of a type.
    fn own(&self) -> HashMap<(Type, String), usize> {
        let mut own = HashMap::new();
        for (place, module) in self.modules.iter().enumerate() {
            for item in &module.items {
                let Item::Impl(item) = item else { continue };
                let Some(of) = self.type_of(place, item) else { continue };
                for member in &item.items {
                    if let ImplItem::Fn(function) = member {
                        own.insert((of.clone(), bare(&function.sig.ident)), module.file);
                    }
                }
            }
        }
        own
    }

    /// The type of an `impl` without a trait.
    fn type_of(&self, module: usize, item: &ItemImpl) -> Option<Type> {
        let (None, syn::Type::Path(path)) = (&item.trait_, &*item.self_ty) else { return None };
        let path = names(&path.path);
        let name = path.last()?.clone();
        let defined = self.resolve(module, &path, &mut HashSet::new());
        defined.into_iter().find_map(|target| match target {
            Target::Item(file) => Some(Type { file, name: name.clone() }),
            Target::Module(_) => None,
        })
    }

    /// Where a path that is written in a module leads; empty if it leaves the crate.
    fn resolve(&self, module: usize, path: &[String], seen: &mut HashSet<(usize, String)>) -> HashSet<Target> {
        let mut at = module;
        let mut rest = path;
        while let [first, others @ ..] = rest {
            match first.as_str() {
                "crate" => at = 0,
                "self" => {}
                "super" => match self.modules[at].parent {
                    Some(parent) => at = parent,
                    None => return HashSet::new(),
                },
                _ => break,
            }
            rest = others;
        }
        let anchored = rest.len() < path.len();
        self.walk(at, rest, anchored, seen)
    }

    /// Where the rest of a path leads from a module. `anchored`: only there, nowhere else.
    fn walk(
        &self,
        module: usize,
        path: &[String],
        anchored: bool,
        seen: &mut HashSet<(usize, String)>,
    ) -> HashSet<Target> {
        let [name, rest @ ..] = path else { return HashSet::from([Target::Module(module)]) };
        let mut targets = HashSet::new();
        let here = &self.modules[module];
        if seen.insert((module, name.clone())) {
            if let Some(definitions) = here.names.get(name) {
                let is_module = definitions.iter().any(|definition| matches!(definition, Definition::Module(_)));
                for definition in definitions {
                    match definition {
                        // A function may have a module's name; a longer path leads through the module.
                        Definition::Item if is_module && !rest.is_empty() => {}
                        Definition::Item => targets.extend([Target::Item(here.file)]),
                        Definition::Module(child) => targets.extend(self.walk(*child, rest, true, seen)),
                        Definition::Path(to) => {
                            targets.extend(self.resolve(module, &[to, rest].concat(), seen));
                        }
                    }
                }
            } else {
                for glob in &here.globs {
                    for target in self.resolve(module, glob, seen) {
                        if let Target::Module(through) = target {
                            targets.extend(self.walk(through, path, false, seen));
                        }
                    }
                }
            }
            seen.remove(&(module, name.clone()));
        }
        if targets.is_empty() && anchored {
            targets.insert(Target::Item(here.file));
        }
        targets
    }

    /// The file of a textual macro that a module sees.
    fn textual_macro(&self, module: usize, name: &str) -> Option<usize> {
        let mut up = iter::successors(Some(module), |&place| self.modules[place].parent);
        up.find_map(|place| {
            let below = self.modules.iter().filter(|child| child.parent == Some(place) && child.macro_use);
            let mut seen = iter::once(&self.modules[place]).chain(below);
            seen.find(|module| module.macros.contains(name)).map(|module| module.file)
        })
    }
}

impl Module {
    /// Records what the item defines, and what is imported inside of it.
    fn define(&mut self, item: &Item) -> Result<()> {
        let name = match item {
            Item::Const(item) => Some(&item.ident),
            Item::Enum(item) => Some(&item.ident),
            Item::Fn(item) => Some(&item.sig.ident),
            Item::Static(item) => Some(&item.ident),
            Item::Struct(item) => Some(&item.ident),
            Item::Trait(item) => Some(&item.ident),
            Item::TraitAlias(item) => Some(&item.ident),
            Item::Type(item) => Some(&item.ident),
            Item::Union(item) => Some(&item.ident),
            Item::Macro(ItemMacro { ident: Some(name), .. }) => {
                self.macros.insert(name.to_string());
                Some(name)
            }
            Item::Macro(item) if item.mac.path.is_ident("include") => {
                let line = item.mac.path.segments[0].ident.span().start().line;
                bail!("line {line}: modules from `include!` are not followed; declare them with `mod`");
            }
            Item::Macro(item) => {
                self.define_tokens(item.mac.tokens.clone());
                None
            }
            _ => None,
        };
        if let Some(name) = name {
            self.names.entry(bare(name)).or_default().push(Definition::Item);
        }
        Uses(self).visit_item(item);
        Ok(())
    }

    /// Items among a macro's arguments, which the macro usually defines.
    fn define_tokens(&mut self, tokens: TokenStream) {
        let mut keyword = false;
        for token in tokens {
            match token {
                TokenTree::Group(group) => self.define_tokens(group.stream()),
                TokenTree::Ident(ident) => {
                    if keyword {
                        self.names.entry(ident.to_string()).or_default().push(Definition::Item);
                    }
                    keyword = ["struct", "enum", "union", "trait", "type", "fn", "const", "static"]
                        .iter()
                        .any(|word| ident == word);
                }
                _ => keyword = false,
            }
        }
    }
}

/// One name of a `use`.
struct Leaf {
    path: Vec<String>,
    /// The name that it gets here; `None` for a `*`.
    name: Option<String>,
    span: Span,
}

/// The names of a `use`; empty if it names another crate with a leading `::`.
fn leaves(item: &ItemUse) -> Vec<Leaf> {
    let mut found = Vec::new();
    if item.leading_colon.is_none() {
        spread(&item.tree, &mut Vec::new(), &mut found);
    }
    found
}

fn spread(tree: &UseTree, before: &mut Vec<String>, found: &mut Vec<Leaf>) {
    let mut leaf = |ident: &Ident, name: &Ident| {
        let mut path = before.clone();
        // `a::{self}` is `a`.
        if ident != "self" || before.is_empty() {
            path.push(bare(ident));
        }
        let name = if name == "self" { path.last().cloned() } else { Some(bare(name)) };
        found.push(Leaf { path, name, span: ident.span() });
    };
    match tree {
        UseTree::Path(path) => {
            before.push(bare(&path.ident));
            spread(&path.tree, before, found);
            before.pop();
        }
        UseTree::Name(name) => leaf(&name.ident, &name.ident),
        UseTree::Rename(rename) => leaf(&rename.ident, &rename.rename),
        UseTree::Glob(glob) => {
            found.push(Leaf { path: before.clone(), name: None, span: glob.star_token.spans[0] });
        }
        UseTree::Group(group) => group.items.iter().for_each(|tree| spread(tree, before, found)),
    }
}

/// Records each `use`, including those inside functions.
struct Uses<'a>(&'a mut Module);

impl<'ast> Visit<'ast> for Uses<'_> {
    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        for leaf in leaves(item) {
            match leaf.name {
                // A name that refers to itself, which is needed to give a macro a path.
                Some(name) if leaf.path == [name.as_str()] => {}
                Some(name) => self.0.names.entry(name).or_default().push(Definition::Path(leaf.path)),
                None => self.0.globs.push(leaf.path),
            }
        }
    }
}

/// Finds the paths of a module's items.
struct Paths<'a> {
    tree: &'a Tree,
    own: &'a HashMap<(Type, String), usize>,
    module: usize,
    /// The type of this `impl`.
    of: Option<Type>,
    /// File that is imported, path as it is written, line.
    found: Vec<(usize, String, usize)>,
}

impl Paths<'_> {
    fn targets(&self, path: &[String]) -> HashSet<Target> {
        self.tree.resolve(self.module, path, &mut HashSet::new())
    }

    fn add(&mut self, file: usize, path: &[String], span: Span) {
        self.found.push((file, path.join("::"), span.start().line));
    }

    /// A call of the own function of this `impl`'s type.
    fn call(&mut self, name: &Ident) {
        let Some(of) = self.of.clone() else { return };
        let called = bare(name);
        if let Some(&file) = self.own.get(&(of, called.clone())) {
            self.add(file, &["Self".into(), called], name.span());
        }
    }

    /// A path in code.
    fn path(&mut self, path: &[String], span: Span) {
        let names = &self.tree.modules[self.module].names;
        // A name from a `use` counts as imported there, unless it is a module that the path leads through.
        let through = |name: &String| {
            self.targets(std::slice::from_ref(name)).iter().any(|target| matches!(target, Target::Module(_)))
        };
        if path.first().is_some_and(|name| names.contains_key(name) && !(path.len() > 1 && through(name))) {
            return;
        }
        for target in self.targets(path) {
            if let Target::Item(file) = target {
                self.add(file, path, span);
            }
        }
    }

    /// The paths among tokens; `texts`: in strings too, as attributes contain them.
    fn tokens(&mut self, tokens: TokenStream, texts: bool) {
        let tokens: Vec<_> = tokens.into_iter().collect();
        let mut at = 0;
        while let Some(token) = tokens.get(at) {
            at += 1;
            match token {
                TokenTree::Group(group) => self.tokens(group.stream(), texts),
                TokenTree::Literal(literal) => {
                    if let (true, syn::Lit::Str(text)) = (texts, syn::Lit::new(literal.clone())) {
                        // Prose is not a path.
                        let text = Some(text.value()).filter(|text| text.contains("::"));
                        let tokens = text.and_then(|text| text.parse::<TokenStream>().ok());
                        self.tokens(tokens.unwrap_or_default(), false);
                    }
                }
                TokenTree::Ident(first) if !is_member(&tokens[..at - 1]) => {
                    let mut path = vec![bare(first)];
                    while let [colons @ .., TokenTree::Ident(ident)] = tokens.get(at..at + 3).unwrap_or_default() {
                        if !is_double_colon(colons) {
                            break;
                        }
                        path.push(bare(ident));
                        at += 3;
                    }
                    self.path(&path, first.span());
                }
                TokenTree::Ident(_) | TokenTree::Punct(_) => {}
            }
        }
    }
}

/// A name without `r#`.
fn bare(name: &Ident) -> String {
    name.unraw().to_string()
}

fn names(path: &syn::Path) -> Vec<String> {
    path.segments.iter().map(|segment| bare(&segment.ident)).collect()
}

fn is_double_colon(tokens: &[TokenTree]) -> bool {
    matches!(tokens, [first, second] if is_mark(first, ':') && is_mark(second, ':'))
}

/// Whether the token after these is not a path of this crate: after one dot it is a field or method, after `::` a name
/// of another crate or of a type.
fn is_member(before: &[TokenTree]) -> bool {
    match before {
        [.., a, b] => (is_mark(b, '.') && !is_mark(a, '.')) || (is_mark(a, ':') && is_mark(b, ':')),
        [a] => is_mark(a, '.'),
        [] => false,
    }
}

impl<'ast> Visit<'ast> for Paths<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        if !source::only_for_tests(source::attributes(item)) {
            visit::visit_item(self, item);
        }
    }

    fn visit_impl_item(&mut self, item: &'ast ImplItem) {
        if !source::member_only_for_tests(item) {
            visit::visit_impl_item(self, item);
        }
    }

    fn visit_item_impl(&mut self, item: &'ast ItemImpl) {
        self.of = self.tree.type_of(self.module, item);
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
        let again = !matches!(item.vis, Visibility::Inherited);
        for leaf in leaves(item) {
            for target in self.targets(&leaf.path) {
                match target {
                    Target::Item(file) => self.add(file, &leaf.path, leaf.span),
                    Target::Module(module) if again || leaf.name.is_none() => {
                        self.add(self.tree.modules[module].file, &leaf.path, leaf.span);
                    }
                    Target::Module(_) => {}
                }
            }
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if let (None, Some(first)) = (&path.leading_colon, path.segments.first()) {
            match path.segments.get(1) {
                Some(second) if first.ident == "Self" => self.call(&second.ident),
                _ => self.path(&names(path), first.ident.span()),
            }
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, called: &'ast syn::Macro) {
        match called.path.get_ident().map(|ident| (ident.to_string(), ident.span())) {
            Some((name, span)) if !self.tree.modules[self.module].names.contains_key(&name) => {
                if let Some(file) = self.tree.textual_macro(self.module, &name) {
                    self.add(file, &[name], span);
                }
            }
            _ => self.visit_path(&called.path),
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
