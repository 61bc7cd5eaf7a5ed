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

pub use issue::InitOutput;
pub use join::JoinOutput;
pub use show::{DomainOutput, InvitationOutput};

const OFF_THE_SWITCHES: &str = "The domain's key is never needed on a switch, a RIB or a robot: run this where the \
                                key is kept, and \
                                take the file to the member.";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make a domain: a private key (mode 0600) and its card, which is for all to have.
    Init(issue::InitOptions),
    /// Make an entity a member, or renew its membership.
    #[command(after_help = OFF_THE_SWITCHES)]
    Admit(issue::AdmitOptions),
    /// Let whoever holds the line that this prints become a member, once.
    #[command(after_help = "The line holds a private key: give it to the one it is for, and to nobody else.")]
    Invite(issue::InviteOptions),
    /// Become a member by an invitation: makes a key if there is none, and writes the membership
    /// and a configuration.
    Join(join::Options),
    /// Take memberships, invitations and peerings back, and tell the fabric if a daemon answers.
    #[command(after_help = OFF_THE_SWITCHES)]
    Revoke(revoke::Options),
    /// Let another domain do something with this one. The two peer when each has done so.
    #[command(after_help = OFF_THE_SWITCHES)]
    Peer(issue::PeerOptions),
    /// Show a domain's card with what was issued from here, a certificate, or an invitation
    /// (without its key).
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
