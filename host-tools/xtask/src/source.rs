//! Rust source, parsed, its tokens, and which of it is for tests only.

use crate::tree;
use anyhow::Result;
use proc_macro2::{Delimiter, Ident, LineColumn, TokenStream, TokenTree};
use std::path::Path;
use syn::{Attribute, Expr, ExprLit, ImplItem, Item, Lit, Meta, Token, punctuated::Punctuated};

/// Reads and parses a file.
pub fn parse(file: &Path) -> Result<syn::File> {
    syn::parse_file(&tree::text(file)?).map_err(|error| {
        let LineColumn { line, .. } = error.span().start();
        anyhow::anyhow!("{}:{line}: {error}", file.display())
    })
}

/// Whether the token is this punctuation mark.
pub fn is_mark(token: &TokenTree, mark: char) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == mark)
}

/// The tokens, without the attributes that documentation becomes. A group gives its delimiter and "end"; `#!` is one.
pub fn code(tokens: TokenStream) -> Vec<String> {
    let is_inner = |token: &TokenTree| is_mark(token, '!');
    let is_documentation = |token: &TokenTree| match token {
        TokenTree::Group(group) if group.delimiter() == Delimiter::Bracket => {
            matches!(group.stream().into_iter().next(), Some(TokenTree::Ident(name)) if name == "doc")
        }
        _ => false,
    };
    let mut code = Vec::new();
    let mut tokens = tokens.into_iter().peekable();
    while let Some(token) = tokens.next() {
        match token {
            token if is_mark(&token, '#') => {
                let mark = tokens.next_if(is_inner).map_or("#", |_| "#!");
                if tokens.next_if(is_documentation).is_none() {
                    code.push(mark.to_owned());
                }
            }
            TokenTree::Group(group) => {
                code.push(format!("{:?}", group.delimiter()));
                code.extend(self::code(group.stream()));
                code.push("end".to_owned());
            }
            other => code.push(other.to_string()),
        }
    }
    code
}

/// The path in a module's `#[path]`.
pub fn path_attribute(attributes: &[Attribute]) -> Option<String> {
    let attribute = attributes.iter().find(|attribute| attribute.path().is_ident("path"))?;
    match &attribute.meta.require_name_value().ok()?.value {
        Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) => Some(text.value()),
        _ => None,
    }
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
