//! `inerter plot`: one figure of a run.

use std::ffi::OsStr;

use inerter_data::output;
use inerter_view::{
    figure::{render_png, svg},
    page::{Kind, PageError, figure},
};
use serde_json::json;

use super::page;
use crate::{
    Error,
    cmd::{plot::Args, print::print_json, terminal},
};

pub fn run(args: &Args) -> Result<(), Error> {
    let path = args.output.as_path();
    let ending = path.extension().and_then(OsStr::to_str).map(str::to_lowercase);
    let bitmap = match ending.as_deref() {
        Some("png") => true,
        Some("svg") => false,
        _ => return Err(PageError::Format { path: path.display().to_string() }.into()),
    };
    if !args.force {
        output::refuse_existing(path)?;
    }
    terminal::tidy_at_interrupts();
    // clap accepts only these names.
    let kind = Kind::ALL.into_iter().find(|kind| kind.name() == args.figure).unwrap_or(Kind::Force);
    let drawn = figure(&page::content(&args.file, &args.settings)?, kind)?;
    if bitmap {
        render_png(&drawn, path, args.force)?
    } else {
        output::write(path, args.force, svg(&drawn))?
    }
    if args.json {
        let line = json!({ "kind": "plot", "file": path.display().to_string(), "source": args.file.display().to_string(), "figure": drawn.name, "caption": drawn.caption });
        return print_json(&line);
    }
    terminal::say(format!("{}: {}", path.display(), drawn.caption));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_can_be_asked_for() {
        assert_eq!(crate::cmd::plot::FIGURES, Kind::ALL.map(Kind::name));
    }
}
