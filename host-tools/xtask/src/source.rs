//! Rust source as the rules see it: parsed, without its tests.

use anyhow::{Context, Result};
use proc_macro2::{Ident, LineColumn, TokenStream, TokenTree};
use std::{fs, path::Path};
use syn::{Attribute, ImplItem, Item, Meta, Token, punctuated::Punctuated, spanned::Spanned, visit::Visit};

/// A float type or literal.
#[derive(Debug, PartialEq, Eq)]
pub struct Found {
    /// Line, from 1.
    pub line: usize,
    /// The token.
    pub token: String,
}

/// Reads and parses a file.
pub fn parse(file: &Path) -> Result<syn::File> {
    let text = fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    syn::parse_file(&text).map_err(|error| {
        let LineColumn { line, .. } = error.span().start();
        anyhow::anyhow!("{}:{line}: {error}", file.display())
    })
}

/// Whether the file says `#![forbid(unsafe_code)]`.
pub fn forbids_unsafe(file: &syn::File) -> bool {
    file.attrs.iter().any(|attribute| {
        attribute.path().is_ident("forbid")
            && attribute.meta.require_list().is_ok_and(|list| list.tokens.to_string() == "unsafe_code")
    })
}

/// Whether the item with these attributes is compiled for tests only.
pub fn only_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("test")
            || (attribute.path().is_ident("cfg") && attribute.parse_args().is_ok_and(|condition| is_test(&condition)))
    })
}

/// Whether the condition holds in tests only.
fn is_test(condition: &Meta) -> bool {
    let parts = || match condition {
        Meta::List(list) => list.parse_args_with(Punctuated::<Meta, Token![,]>::parse_terminated).ok(),
        _ => None,
    };
    match condition.path().get_ident().map(Ident::to_string).as_deref() {
        Some("test") => true,
        Some("all") => parts().is_some_and(|parts| parts.iter().any(is_test)),
        Some("any") => parts().is_some_and(|parts| !parts.is_empty() && parts.iter().all(is_test)),
        _ => false,
    }
}

/// An item's attributes.
pub fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::ExternCrate(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::ForeignMod(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Macro(item) => &item.attrs,
        Item::Mod(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Trait(item) => &item.attrs,
        Item::TraitAlias(item) => &item.attrs,
        Item::Type(item) => &item.attrs,
        Item::Union(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => &[],
    }
}

/// Whether a member of an `impl` is compiled for tests only.
pub fn member_only_for_tests(item: &ImplItem) -> bool {
    match item {
        ImplItem::Const(item) => only_for_tests(&item.attrs),
        ImplItem::Fn(item) => only_for_tests(&item.attrs),
        ImplItem::Type(item) => only_for_tests(&item.attrs),
        ImplItem::Macro(item) => only_for_tests(&item.attrs),
        _ => false,
    }
}

/// Every float type (`f32`, `f64`, also as a suffix) and float literal outside of tests, in macros too.
pub fn floats(file: &syn::File) -> Vec<Found> {
    let mut floats = Floats(Vec::new());
    floats.visit_file(file);
    floats.0
}

struct Floats(Vec<Found>);

impl Floats {
    fn add(&mut self, token: &(impl Spanned + ToString)) {
        self.0.push(Found { line: token.span().start().line, token: token.to_string() });
    }

    fn tokens(&mut self, tokens: TokenStream) {
        for token in tokens {
            match token {
                TokenTree::Group(group) => self.tokens(group.stream()),
                TokenTree::Ident(ident) => self.visit_ident(&ident),
                TokenTree::Literal(literal) => match syn::Lit::new(literal) {
                    syn::Lit::Float(float) => self.visit_lit_float(&float),
                    syn::Lit::Int(int) => self.visit_lit_int(&int),
                    _ => {}
                },
                TokenTree::Punct(_) => {}
            }
        }
    }
}

impl<'ast> Visit<'ast> for Floats {
    fn visit_item(&mut self, item: &'ast Item) {
        if !only_for_tests(attributes(item)) {
            syn::visit::visit_item(self, item);
        }
    }

    fn visit_impl_item(&mut self, item: &'ast ImplItem) {
        if !member_only_for_tests(item) {
            syn::visit::visit_impl_item(self, item);
        }
    }

    fn visit_attribute(&mut self, _: &'ast Attribute) {}

    fn visit_ident(&mut self, ident: &'ast Ident) {
        if ident == "f32" || ident == "f64" {
            self.add(ident);
        }
    }

    fn visit_lit_float(&mut self, literal: &'ast syn::LitFloat) {
        self.add(literal);
    }

    fn visit_lit_int(&mut self, literal: &'ast syn::LitInt) {
        if matches!(literal.suffix(), "f32" | "f64") {
            self.add(literal);
        }
    }

    fn visit_macro(&mut self, called: &'ast syn::Macro) {
        self.tokens(called.tokens.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tokens(text: &str) -> Vec<String> {
        let file = syn::parse_file(&format!("fn f() {{ {text} }}")).unwrap();
        floats(&file).into_iter().map(|found| found.token).collect()
    }

    #[test]
    fn floats_in_code_are_found() {
        assert_eq!(tokens("let a: f32 = 1.0;"), ["f32", "1.0"]);
        assert_eq!(tokens("let a = 2f64 + 1e3 + 5.;"), ["2f64", "1e3", "5."]);
        assert_eq!(tokens("let a = b as f64;"), ["f64"]);
        assert_eq!(tokens("let a = 1.5e3_f32;"), ["1.5e3_f32"]);
        assert_eq!(tokens("m!(f64, [1.5, 2f32])"), ["f64", "1.5", "2f32"]);
    }

    #[test]
    fn integers_are_left_alone() {
        for text in
            ["1..2", "0..=9", "t.0.1", "1.max(2)", "0x1e5", "0xf32", "1_000usize", "self.f32_count", "1i64 << 62"]
        {
            assert!(tokens(text).is_empty(), "{text}: {:?}", tokens(text));
        }
    }

    #[test]
    fn comments_strings_and_tests_do_not_count() {
        let text = "// f32\n/* 1.0 */ fn a<'x>(b: &'x str, c: char) {}\n/// f32 in a doc\nconst S: &str = \"f64 1.0\";\n\
            #[cfg(test)]\nmod tests {\n fn a() { if true { let x = 1.0; } }\n}\n\
            struct A;\nimpl A {\n #[cfg(all(test, unix))]\n fn x() -> f32 { 1.0 }\n}\n\
            #[cfg(any(test, unix))]\nfn last() -> f32 {}\n";
        assert_eq!(floats(&syn::parse_file(text).unwrap()), [Found { line: 15, token: "f32".into() }]);
    }

    #[test]
    fn a_file_that_forbids_unsafe_says_so_outside_of_comments() {
        let forbids = |text| forbids_unsafe(&syn::parse_file(text).unwrap());
        assert!(forbids("#![forbid(unsafe_code)]"));
        assert!(!forbids("// #![forbid(unsafe_code)]"));
        assert!(!forbids("#![deny(unsafe_code)]"));
    }
}
