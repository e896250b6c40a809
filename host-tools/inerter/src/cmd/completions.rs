//! `inerter completions` and `inerter man`: shell completions and manual pages.

use std::path::{Path, PathBuf};

use clap::Command;
use clap_complete::Shell;
use inerter_data::output;

use super::terminal::say;
use crate::Error;

/// Print what a shell needs to complete this program's command lines.
///
/// For example: inerter completions bash > ~/.local/share/bash-completion/completions/inerter
#[derive(clap::Args)]
pub struct Args {
    /// Which shell
    shell: Shell,
}

/// Write the manual pages, one for each command.
///
/// For example: inerter man -o ~/.local/share/man/man1, then: man inerter-record
#[derive(clap::Args)]
pub struct ManArgs {
    /// Folder to write them to, which is created if needed
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
    /// Replace pages that exist
    #[arg(long)]
    force: bool,
}

pub fn run(args: &Args, mut command: Command) -> Result<(), Error> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, "inerter", &mut text);
    Ok(output::text(String::from_utf8_lossy(&text))?)
}

pub fn man(args: &ManArgs, command: Command) -> Result<(), Error> {
    let failed = |source| output::OutputError::Create { path: args.output.clone(), source };
    std::fs::create_dir_all(&args.output).map_err(failed)?;
    // Pages that refer to each other need the whole tree built first.
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let mut pages = Vec::new();
    render(&command, &args.output, &mut pages).map_err(failed)?;
    if !args.force {
        pages.iter().try_for_each(|(page, _)| output::refuse_existing(page))?;
    }
    pages.iter().try_for_each(|(page, text)| output::write(page, args.force, text))?;
    say(format!("manual pages written to {}", args.output.display()));
    Ok(())
}

/// The pages of a command and its subcommands.
fn render(command: &Command, folder: &Path, pages: &mut Vec<(PathBuf, Vec<u8>)>) -> std::io::Result<()> {
    for below in command.get_subcommands().filter(|below| !below.is_hide_set()) {
        render(below, folder, pages)?;
    }
    let page = clap_mangen::Man::new(command.clone());
    let mut text = Vec::new();
    page.render(&mut text)?;
    pages.push((folder.join(page.get_filename()), text));
    Ok(())
}
