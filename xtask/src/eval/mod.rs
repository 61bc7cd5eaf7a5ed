//! `cargo xtask eval FIGURE`: the evaluation of the paper, made again on this system
//! (`docs/evaluation.md`).

mod fig5;

use anyhow::Result;

#[derive(clap::Args)]
pub struct Options {
    #[command(subcommand)]
    figure: Evaluation,
}

#[derive(clap::Subcommand)]
enum Evaluation {
    /// Measure the one-way latency over the message size through three nodes, for every setup
    Fig5(fig5::Options),
}

pub fn run(options: Options) -> Result<()> {
    match options.figure {
        Evaluation::Fig5(options) => fig5::run(options),
    }
}
