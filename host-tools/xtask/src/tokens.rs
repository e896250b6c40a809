//! How many Rust tokens each crate has, without comments, and those of its tests apart.
//!
//! Tests: files below the crate's folder `tests`, and what is compiled for tests only.

use crate::{
    commit::commit,
    copy, source, table, tree,
    workspace::{Member, Workspace},
};
use anyhow::{Context, Result};
use proc_macro2::TokenStream;
use quote::ToTokens;
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};
use syn::{
    ImplItem, Item, ItemMod,
    spanned::Spanned,
    visit::{self, Visit},
};

/// Prints the table; with `update` also writes it. It differs after each change of code, so nothing compares it.
pub fn run(update: bool) -> Result<()> {
    let members = Workspace::with_all_members()?.members;
    let files: Vec<PathBuf> = copy::files(&["*.rs"])?.into_iter().map(|file| tree::root().join(file)).collect();
    let counts = counted(&members, &files)?;
    let mut text = format!(
        "# Rust tokens of each crate\n\n\
         Tokens are identifiers, literals, punctuation marks and delimiters, without comments. Tests are the\n\
         files below the crate's `tests`, and what is compiled for tests only.\n\n\
         Written by `cargo xtask cost --tokens --update`, of commit {}.\n\n\
         | crate | code | tests |\n|---|--:|--:|\n",
        commit()
    );
    let total = counts.values().fold([0_usize; 2], |sum, count| [sum[0] + count[0], sum[1] + count[1]]);
    for (name, [code, tests]) in counts.into_iter().chain([("all", total)]) {
        text += &format!("| {name} | {code} | {tests} |\n");
    }
    print!("{text}");
    if update { table::write_text("tokens", &text) } else { Ok(()) }
}

/// Tokens of each member in these files: of its code, and of its tests.
fn counted<'a>(members: &'a [Member], files: &[PathBuf]) -> Result<BTreeMap<&'a str, [usize; 2]>> {
    let mut sources = BTreeMap::new();
    for file in files {
        sources.insert(file, Source::read(file)?);
    }
    let mut left: Vec<&PathBuf> = sources.values().flat_map(|source| &source.test_modules).collect();
    let mut for_tests = BTreeSet::new();
    while let Some(file) = left.pop() {
        if for_tests.insert(file) {
            left.extend(sources.get(file).into_iter().flat_map(|source| &source.modules));
        }
    }
    let mut counts = BTreeMap::<_, [usize; 2]>::new();
    for (file, source) in &sources {
        let holders = members.iter().filter(|member| file.starts_with(&member.folder));
        let member = holders.max_by_key(|member| member.folder.components().count());
        let member = member.with_context(|| format!("{} belongs to no crate", file.display()))?;
        let is_test = for_tests.contains(file) || file.starts_with(member.folder.join("tests"));
        let tests = if is_test { source.tokens } else { source.test_tokens };
        let count = counts.entry(member.name.as_str()).or_default();
        *count = [count[0] + source.tokens - tests, count[1] + tests];
    }
    Ok(counts)
}

/// What is counted in a file.
#[derive(Default)]
struct Source {
    path: PathBuf,
    tokens: usize,
    test_tokens: usize,
    /// Files of the modules that it declares, and of those that it declares for tests only.
    modules: Vec<PathBuf>,
    test_modules: Vec<PathBuf>,
}

impl Source {
    fn read(path: &Path) -> Result<Self> {
        let mut source = Self { path: path.into(), tokens: count(&tree::text(path)?), ..Self::default() };
        source.visit_file(&source::parse(path)?);
        Ok(source)
    }

    /// Whether the item is for tests only; if so, counts it.
    fn is_test(&mut self, item: &impl ToTokens) -> bool {
        let is_test = source::only_for_tests(item);
        if is_test {
            self.test_tokens += count(&item.span().source_text().unwrap_or_default());
        }
        is_test
    }
}

impl<'ast> Visit<'ast> for Source {
    fn visit_item(&mut self, item: &'ast Item) {
        let is_test = self.is_test(item);
        if let Item::Mod(module @ ItemMod { content: None, .. }) = item {
            let file = source::module_file(&self.path, Path::new(""), module);
            if is_test { &mut self.test_modules } else { &mut self.modules }.push(file);
        }
        if !is_test {
            visit::visit_item(self, item);
        }
    }

    fn visit_impl_item(&mut self, item: &'ast ImplItem) {
        if !self.is_test(item) {
            visit::visit_impl_item(self, item);
        }
    }
}

/// Tokens of a source, which must be sound.
fn count(text: &str) -> usize {
    text.parse::<TokenStream>().map_or(0, |tokens| source::code(tokens).len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;

    #[test]
    fn tokens_of_tests_stand_apart_and_comments_are_none() {
        let files = [
            // 14 tokens of `f`, 3 of `mod b`; 10 for tests of `mod c`, 17 of `mod tests`.
            (
                "src/lib.rs",
                "//! Words.\n/// 1 µm.\npub fn f(a: u8) -> u8 { a } // End.\nmod b;\n\
                 #[cfg(test)]\nmod c;\n/// Tests.\n#[cfg(test)]\nmod tests { use super::*; }\n",
            ),
            ("src/b.rs", "const B: &str = \"two words\";"),
            ("src/c.rs", "mod d;"),
            ("src/c/d.rs", "#![allow(dead_code)]\nfn g() {}"),
            ("tests/all.rs", "use a::f;"),
            ("tests/inner/src/lib.rs", "struct S; impl S { #[cfg(test)] fn h() {} }"),
        ];
        let fixture = Fixture::new(&files);
        let paths = files.map(|(path, _)| fixture.0.join(path));
        let member = |name: &str, folder| Member { name: name.into(), folder, roots: Vec::new(), uses: Vec::new() };
        let members = [member("a", fixture.0.clone()), member("inner", fixture.0.join("tests/inner"))];
        let expected = [("a", [14 + 3 + 8, 10 + 17 + 3 + 13 + 6]), ("inner", [3 + 4, 7 + 6])];
        assert_eq!(counted(&members, &paths).unwrap(), BTreeMap::from(expected));
    }
}
