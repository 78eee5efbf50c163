//! `pix2hdr completions` and `pix2hdr man`: what a shell and `man` want to know of this program.

use std::io::{ErrorKind, Write};

use crate::{Error, Result};
use clap::{Args, Command};
use clap_complete::Shell;
use clap_mangen::Man;

/// Prints completions for a shell
///
/// For bash: `pix2hdr completions bash > ~/.local/share/bash-completion/completions/pix2hdr`.
#[derive(Args)]
pub struct CompletionsArgs {
    /// The shell
    shell: Shell,
}

/// Prints a manual page
///
/// `pix2hdr man synth > pix2hdr-synth.1` writes that of `synth`, which `man -l pix2hdr-synth.1` shows.
#[derive(Args)]
pub struct ManArgs {
    /// Command that it is about [default: the whole program]
    #[arg(value_name = "COMMAND")]
    about: Option<String>,
}

impl CompletionsArgs {
    /// Runs the command; `whole` is the command line, as clap knows it.
    pub fn run(&self, mut whole: Command) -> Result<()> {
        let mut text = Vec::new();
        clap_complete::generate(self.shell, &mut whole, "pix2hdr", &mut text);
        print(&text)
    }
}

impl ManArgs {
    /// Runs the command; `whole` is the command line, as clap knows it.
    pub fn run(&self, mut whole: Command) -> Result<()> {
        whole.build();
        let page = match &self.about {
            None => whole,
            Some(name) => {
                let unknown =
                    || Error::Usage(format!("there is no command '{name}'; `pix2hdr --help` lists them"));
                whole.find_subcommand(name).ok_or_else(unknown)?.clone()
            }
        };
        let mut text = Vec::new();
        Man::new(page).render(&mut text)?;
        print(&text)
    }
}

fn print(text: &[u8]) -> Result<()> {
    match std::io::stdout().write_all(text) {
        // Whoever reads has seen enough.
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        outcome => Ok(outcome?),
    }
}
