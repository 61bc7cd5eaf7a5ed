//! `gdp-ctl grant`: an owner's grants to others for a name. The commands run on the machine with
//! the owner's key, without a daemon. Only a revocation goes to a daemon, if one answers.

mod add;
mod ledger;
mod list;
mod revoke;

use clap::Subcommand;

use crate::cli::context::Context;

pub use list::GrantsOutput;

const OFF_THE_ROBOT: &str = "The owner's key is never needed on a robot, nor on any machine that publishes, reads or \
                             forwards: run this where the key is kept, and take the certificate file and the name card \
                             to the robot.";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Let an entity publish or read a name, a domain's role read it, or another key issue such
    /// grants.
    #[command(after_help = OFF_THE_ROBOT)]
    Add(add::Options),
    /// Show what was granted from here, and what of it still holds.
    List(list::Options),
    /// Take grants back, and tell the fabric if a daemon answers.
    #[command(after_help = OFF_THE_ROBOT)]
    Revoke(revoke::Options),
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Add(options) => add::run(options, context),
        Command::List(options) => list::run(&options, context),
        Command::Revoke(options) => revoke::run(&options, context),
    }
}
