//! `inerter report`: a run as a page to share.

use std::{fs, path::Path};

use inerter_analysis::results::LimitsJson;
use inerter_data::output::{self, OutputError};
use inerter_view::{
    figure::render_png,
    page::{Content, html},
};

use crate::{
    Error,
    cmd::{
        args::FileSettingsArgs,
        limits::{Held, heard, judged_line, prove},
        print::print_machine_json,
        report::Args,
        terminal::{self, Progress},
    },
};

/// What was written, in JSON.
#[derive(serde::Serialize)]
struct ReportJson {
    kind: &'static str,
    file: String,
    source: String,
    figures: Vec<&'static str>,
    png: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    limits: Option<LimitsJson>,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let settings = args.settings.settings.settings.as_deref();
    args.limits.check([args.file.as_path()].into_iter().chain(settings), [args.output.as_path()], args.force)?;
    let content = content(&args.file, &args.settings)?;
    let machine = content.run.settings.machine;
    let limits = args.limits.read(machine)?;
    let within = limits.map(|limits| content.told().within(&limits));
    let judged = within.as_deref().unwrap_or_default();
    let (page, figures) = html(&content, judged);
    let mut images = Vec::new();
    if let Some(folder) = &args.png {
        make_folder(folder)?;
        let mut progress = Progress::new("drawing", figures.len() as u64);
        for (number, figure) in figures.iter().enumerate() {
            let path = folder.join(format!("{}.png", figure.name));
            render_png(figure, &path, args.force)?;
            progress.set(number as u64 + 1);
            images.push(path.display().to_string());
        }
        progress.done();
    }
    output::write(&args.output, args.force, &page)?;
    let held = [Held { run: args.file.display().to_string(), is_file: true, machine, judged }];
    args.limits.write(args.force, &held)?;
    let file = args.output.display();
    if args.json {
        let line = ReportJson {
            kind: "report",
            file: file.to_string(),
            source: args.file.display().to_string(),
            figures: figures.iter().map(|figure| figure.name).collect(),
            png: images,
            limits: within.as_deref().map(LimitsJson::new),
        };
        return prove(&held).and(heard(print_machine_json(machine, &line), true));
    }
    terminal::say(format!("{file}: {} figures; open it in a browser, and print it from there", figures.len()));
    if let Some(folder) = &args.png {
        terminal::say(format!("{}: {} PNG files", folder.display(), images.len()));
    }
    let said = judged.iter().try_for_each(|judged| output::line(judged_line(machine, judged)));
    prove(&held).and(heard(said.map_err(Error::from), true))
}

/// Reads a file and runs it through the estimator, with a progress bar.
pub fn content(file: &Path, settings: &FileSettingsArgs) -> Result<Content, Error> {
    let run = settings.open(file)?;
    let mut progress = Progress::new("replaying", 1000);
    let content = Content::of(run, |part| progress.set_part(part))?;
    progress.done();
    Ok(content)
}

/// Creates a folder and its parents.
pub fn make_folder(folder: &Path) -> Result<(), OutputError> {
    fs::create_dir_all(folder).map_err(|source| OutputError::Create { path: folder.into(), source })
}
