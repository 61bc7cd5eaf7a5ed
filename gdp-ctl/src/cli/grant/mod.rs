//! `gdp-ctl grant`: an owner's grants to others for a name. The commands run on the machine with
//! the owner's key, without a daemon. Only a revocation goes to a daemon, if one answers.

mod add;
mod issuer;
mod ledger;
mod list;
mod renew;
mod revoke;

use clap::Subcommand;

use crate::cli::context::Context;

pub use list::GrantsOutput;

const OFF_THE_ROBOT: &str = "Run this command on the machine that stores the owner's key, and copy the certificate \
                             file and the name card to the robot. No robot, and no machine that publishes, reads or \
                             forwards, needs the owner's key.";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Grant an entity the right to publish or read a name. A grant can also let a domain's role
    /// read it, or another key issue such grants.
    #[command(after_help = OFF_THE_ROBOT)]
    Add(add::Options),
    /// Renew grants that were issued here, with the same rights. Replaces each file atomically.
    #[command(after_help = OFF_THE_ROBOT)]
    Renew(renew::Options),
    /// List the grants in the ledger of a name, and show which are still valid.
    List(list::Options),
    /// Revoke grants, and publish the revocation if a daemon answers.
    #[command(after_help = OFF_THE_ROBOT)]
    Revoke(revoke::Options),
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Add(options) => add::run(options, context),
        Command::Renew(options) => renew::run(&options, context),
        Command::List(options) => list::run(&options, context),
        Command::Revoke(options) => revoke::run(&options, context),
    }
}
