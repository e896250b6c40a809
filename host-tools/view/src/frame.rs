//! What all pages share: one file that loads nothing, light and dark schemes, and a print layout.

use inerter_data::words::printable_lines;
use maud::{DOCTYPE, Markup, PreEscaped, html as markup};

use crate::figure::{Colour, Figure, css, svg_for_page};

/// The style sheet of a page, for both schemes and print. Colours come from the figures' table.
pub fn page_css() -> String {
    let variables = |of: fn(Colour) -> [u8; 3]| {
        Colour::ALL.map(|colour| format!("{}:{};", colour.variable(), css(of(colour)))).concat()
    };
    let (light, dark) = (variables(Colour::rgb), variables(Colour::dark_rgb));
    format!(
        ":root{{{light}color-scheme:light dark}}\
         @media (prefers-color-scheme:dark){{:root{{{dark}}}}}\
         @media print{{:root{{{light}color-scheme:light}}}}\
         {}",
        // A checkout may have other line ends.
        include_str!("frame.css").replace('\r', "")
    )
}

/// A page with this title and kind, a heading, a line below it, and its sections. Its texts may come from anywhere:
/// invisible characters, and those that change the writing direction, are escaped.
pub(crate) fn framed(title: &str, kind: &str, heading: &str, meta: &Markup, main: &Markup) -> String {
    let page = markup! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="generator" content=(concat!("inerter ", env!("CARGO_PKG_VERSION")));
                title { "Inerter: " (title) }
                style { (PreEscaped(page_css())) }
            }
            body {
                header {
                    p.kind { "Instrumented inerter: " (kind) }
                    h1 { (heading) }
                    p.meta { (meta) }
                }
                main { (main) }
            }
        }
    };
    printable_lines(&page.into_string()).into_owned()
}

/// The head of a table: columns of texts, of numbers, and of texts again.
pub(crate) fn head(texts: &[&str], numbers: &[&str], more: &[&str]) -> Markup {
    markup! {
        thead { tr {
            @for name in texts { th scope="col" { (name) } }
            @for name in numbers { th.number scope="col" { (name) } }
            @for name in more { th scope="col" { (name) } }
        } }
    }
}

/// A section with a figure, below its title.
pub(crate) fn figure_section(figure: &Figure) -> Markup {
    markup! {
        section id=(figure.name) {
            h2 { (figure.title) }
            (drawn(figure))
        }
    }
}

/// A figure with its caption.
pub(crate) fn drawn(figure: &Figure) -> Markup {
    markup! {
        figure {
            (PreEscaped(svg_for_page(figure)))
            figcaption { (figure.caption) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invisible_characters_are_escaped_in_a_page_and_not_in_its_style() {
        let text = "a\u{1b}[2J\n\u{202e}b\u{200b}\u{fe0f}";
        let page = framed(text, "runs", text, &markup! { (text) }, &markup! { p title=(text) { (text) } });
        assert_eq!(page.matches("a\\u001b[2J\n\\u202eb\\u200b\\ufe0f").count(), 5, "{page}");
        assert!(!page.contains(['\u{1b}', '\u{202e}', '\u{200b}', '\u{fe0f}']));
        assert!(page.contains(&page_css()));
    }
}
