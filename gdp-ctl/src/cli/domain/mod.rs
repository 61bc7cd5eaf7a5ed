//! `gdp-ctl domain`: a trust domain and its members. The commands work on files on the machine with
//! the domain's key. Only a revocation goes to a daemon, if one answers. `join` runs on the machine
//! of a new member, and needs only the member's own key.

mod authority;
mod issue;
mod join;
mod ledger;
mod revoke;
mod show;

use clap::Subcommand;

use crate::cli::context::Context;

pub use authority::{Authority, DomainLedger};
pub use issue::{InitOutput, create_domain};
pub use join::{JoinOutput, quoted};
pub use ledger::{Issue, To};
pub use show::{DomainOutput, InvitationOutput};

const OFF_THE_SWITCHES: &str = "Run this command on the machine that stores the domain's key, and copy the file to the \
                                member. No switch, RIB or robot needs the domain's key.";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Create a domain: a private key (mode 0600) and a card, which is public.
    Init(issue::InitOptions),
    /// Admit an entity as a member, or renew its membership.
    #[command(after_help = OFF_THE_SWITCHES)]
    Admit(issue::AdmitOptions),
    /// Print an invitation for a new member. It can be used once.
    #[command(after_help = "The invitation contains a private key. Give it only to the intended member.")]
    Invite(issue::InviteOptions),
    /// Join a domain with an invitation. Generates a key if none exists, and writes the membership
    /// and a configuration.
    Join(join::Options),
    /// Revoke memberships, invitations and peerings, and publish the revocation if a daemon
    /// answers.
    #[command(after_help = OFF_THE_SWITCHES)]
    Revoke(revoke::Options),
    /// Grant another domain rights in this one. Two domains peer when each has granted rights to
    /// the other.
    #[command(after_help = OFF_THE_SWITCHES)]
    Peer(issue::PeerOptions),
    /// Show a domain's card with its ledger of issued certificates, a single certificate, or an
    /// invitation (without its key).
    Show(show::Options),
}

pub fn run(command: Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Init(options) => issue::init(&options, context),
        Command::Admit(options) => issue::admit(&options, context),
        Command::Invite(options) => issue::invite(&options, context),
        Command::Join(options) => join::run(&options, context),
        Command::Revoke(options) => revoke::run(&options, context),
        Command::Peer(options) => issue::peer(&options, context),
        Command::Show(options) => show::run(&options, context),
    }
}
