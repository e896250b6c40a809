//! Rust source, parsed, its tokens, where its modules are, and which of it is for tests only.

use crate::tree;
use anyhow::Result;
use proc_macro2::{Delimiter, Group, Ident, LineColumn, TokenStream, TokenTree};
use quote::ToTokens;
use std::path::{Path, PathBuf};
use syn::{
    Attribute, Expr, ExprLit, ItemMod, Lit, Meta, Token,
    ext::IdentExt,
    parse::{ParseStream, Parser},
    punctuated::Punctuated,
};

/// Reads and parses a file.
pub fn parse(file: &Path) -> Result<syn::File> {
    syn::parse_file(&tree::text(file)?).map_err(|error| {
        let LineColumn { line, .. } = error.span().start();
        anyhow::anyhow!("{}:{line}: {error}", file.display())
    })
}

/// The tokens, without the attributes that documentation becomes. A group gives its delimiter and "end"; `#!` is one.
pub fn code(tokens: TokenStream) -> Vec<String> {
    let mut code: Vec<String> = Vec::new();
    for token in tokens {
        let in_attribute = code.last().is_some_and(|last| last == "#" || last == "#!");
        match token {
            TokenTree::Punct(mark) if in_attribute && mark.as_char() == '!' => {
                code.pop();
                code.push("#!".to_owned());
            }
            TokenTree::Group(group) if in_attribute && is_documentation(&group) => drop(code.pop()),
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

fn is_documentation(group: &Group) -> bool {
    let first = group.stream().into_iter().next();
    group.delimiter() == Delimiter::Bracket && matches!(first, Some(TokenTree::Ident(name)) if name == "doc")
}

/// The file of a module: beside the one that declares it if that is a crate's root or itself stands for a folder, else
/// below it. `within`: the names of the modules around it in that file.
pub fn module_file(file: &Path, within: &Path, module: &ItemMod) -> PathBuf {
    let folder = file.parent().unwrap_or(file);
    for attribute in &module.attrs {
        if let Meta::NameValue(given) = &attribute.meta
            && given.path.is_ident("path")
            && let Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) = &given.value
        {
            return folder.join(text.value());
        }
    }
    let within = within.join(module.ident.unraw().to_string());
    let below = [file.with_extension(""), folder.into()].map(|folder| folder.join(&within));
    let mut places = below.iter().flat_map(|place| [place.with_extension("rs"), place.join("mod.rs")]);
    places.find(|place| place.is_file()).unwrap_or_else(|| folder.join(within))
}

/// Whether this item, or member of an `impl`, is compiled for tests only.
pub fn only_for_tests(item: &impl ToTokens) -> bool {
    let outer = |input: ParseStream| {
        let attributes = Attribute::parse_outer(input)?;
        input.parse::<TokenStream>().map(|_| attributes)
    };
    let attributes = outer.parse2(item.to_token_stream()).unwrap_or_default();
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
