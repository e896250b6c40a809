//! Rust source, parsed, and which of it is for tests only.

use anyhow::{Context, Result};
use proc_macro2::{Ident, LineColumn};
use std::{fs, path::Path};
use syn::{Attribute, ImplItem, Item, Meta, Token, punctuated::Punctuated};

/// Reads and parses a file.
pub fn parse(file: &Path) -> Result<syn::File> {
    let text = fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    syn::parse_file(&text).map_err(|error| {
        let LineColumn { line, .. } = error.span().start();
        anyhow::anyhow!("{}:{line}: {error}", file.display())
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
