//! The command line: one file a command.

mod bench;
mod dataset;
mod demo;
mod devices;
mod eval;
mod import;
mod interrupt;
pub mod options;
mod quiet;
mod sample;
mod scene;
mod shell;
mod stability;
mod suite;
mod synth;
mod table;
pub mod terminal;
mod view;
mod weights;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

use crate::Result;
use crate::system::version;

/// Turns the output of pixel-wise programmable cameras into 1000 fps HDR video.
#[derive(Parser)]
#[command(version = version(), about, long_about = None, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// Says more on standard error; twice, everything
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
}

#[derive(Subcommand)]
enum Command {
    Demo(demo::Demo),
    Scene(scene::SceneCommand),
    Sample(sample::Sample),
    Import(import::Import),
    Synth(synth::Synth),
    Eval(eval::Eval),
    Suite(suite::SuiteCommand),
    Bench(bench::Bench),
    View(view::ViewArgs),
    Dataset(dataset::Dataset),
    Devices(devices::Devices),
    Weights(weights::WeightsArgs),
    Completions(shell::CompletionsArgs),
    Man(shell::ManArgs),
}

/// The command line, as clap knows it.
pub fn command() -> clap::Command {
    Arguments::command()
}

/// Runs the program with the arguments of this process.
pub fn main() -> ExitCode {
    quiet::without_wayland();
    terminal::exit_code("pix2hdr", Arguments::parse().run())
}

impl Arguments {
    /// Runs the command.
    fn run(self) -> Result<()> {
        terminal::log(self.verbose);
        let interrupt = interrupt::Interrupt::install()?;
        match self.command {
            Command::Demo(command) => command.run(),
            Command::Scene(command) => command.run(),
            Command::Sample(command) => command.run(),
            Command::Import(command) => command.run(),
            Command::Synth(command) => command.run(&interrupt),
            Command::Eval(command) => command.run(),
            Command::Suite(command) => command.run(),
            Command::Bench(command) => command.run(),
            Command::View(command) => command.run(self.verbose),
            Command::Dataset(command) => command.run(),
            Command::Devices(command) => command.run(),
            Command::Weights(command) => command.run(),
            Command::Completions(completions) => completions.run(command()),
            Command::Man(man) => man.run(command()),
        }
    }
}
