//! `gdp-ctl domain join`: creates the files of a member from an invitation.

use std::io::Read;
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::cert::domain::roles;
use gdp_core::domain::Token;
use gdp_core::identity::Identity;
use gdp_core::link_target::LinkTarget;
use gdp_util::date::relative;
use gdp_util::escape::escape_json;
use gdp_util::unix_time::unix_seconds;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::super::output;
use super::issue::check_address;
use crate::cli::context::Context;
use crate::cli::domain::authority::expect_new;
use crate::cli::issuing::{serial_now, validity};

/// Maximum length of an invitation on stdin, in bytes.
const MAX_LINE: u64 = 16 << 10;

#[derive(Debug, Args)]
pub struct Options {
    /// Invitation. `-` reads it from stdin, which keeps it out of process lists.
    token: String,
    /// Private key file of the new member, generated if it does not exist.
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// Folder for the new files domain.card, membership and gdp.yaml, and for the key unless
    /// --identity names its file.
    #[arg(short, long, value_name = "DIR", default_value = ".")]
    output: PathBuf,
}

/// Output of `gdp-ctl domain join`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct JoinOutput {
    name: Name,
    domain: Name,
    role: String,
    /// End of the membership, in Unix seconds.
    not_after: u64,
    /// The private key.
    identity: PathBuf,
    card: PathBuf,
    membership: PathBuf,
    config: PathBuf,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let token = read_token(&options.token)?;
    let invite = token.invite()?;
    let is_switch = roles::is_switch(&invite.role);
    let kind = if is_switch { "switch" } else { "proxy" };
    let folder = &options.output;
    gdp_util::ownership::create(folder).with_context(|| format!("cannot create the folder {}", folder.display()))?;
    let [card_file, membership_file, config_file] =
        ["domain.card", "membership", "gdp.yaml"].map(|name| folder.join(name));
    for file in [&card_file, &membership_file, &config_file] {
        expect_new(file)?;
    }
    let own_key = folder.join(format!("{kind}.pem"));
    let identity_file = options.identity.as_deref().unwrap_or(&own_key);
    let identity_at = match &options.identity {
        Some(file) => std::path::absolute(file).with_context(|| file.display().to_string())?,
        None => PathBuf::from(format!("{kind}.pem")),
    };
    // Check everything before writing any file.
    let config = if is_switch { switch(&token, &invite.role, &identity_at)? } else { proxy(&token, &identity_at) };
    let card = token.domain_card()?;
    let identity = Identity::load_or_generate(identity_file, kind)?;
    let serial = serial_now();
    let (not_before, _) = validity(0);
    let membership = token.admit(identity.name(), not_before, serial)?;
    output::write_new(&card_file, &card.to_json())?;
    output::write_new(&membership_file, &membership.to_pem())?;
    output::write_new(&config_file, &config)?;
    let output = JoinOutput {
        name: identity.name(),
        domain: invite.domain,
        role: invite.role,
        not_after: invite.member_until,
        identity: identity_file.into(),
        card: card_file,
        membership: membership_file,
        config: config_file,
    };
    context.output.print(&output, || {
        let until = relative(output.not_after, unix_seconds());
        let next = if is_switch { "" } else { ", to which you add topics or expose" };
        let (name, role, domain, config) = (output.name, &output.role, output.domain, output.config.display());
        [format!("{name} is {role} of {domain:#} until {until}: {config}{next}")]
    })
}

/// Returns an invitation from the argument, or from stdin.
pub fn read_token(argument: &str) -> anyhow::Result<Token> {
    if argument != "-" {
        return Ok(Token::from_line(argument)?);
    }
    let mut line = String::new();
    std::io::stdin().take(MAX_LINE).read_to_string(&mut line).context("cannot read the invitation from stdin")?;
    let token = Token::from_line(&line);
    line.clear();
    Ok(token?)
}

fn switch(token: &Token, role: &str, identity: &Path) -> anyhow::Result<String> {
    check_address(token.at())?;
    let via = match token.at() {
        LinkTarget::Ethernet { interface, .. } => format!("interface: {}", quoted(interface)),
        LinkTarget::Udp { host, port, .. } => {
            let ip: IpAddr = host.parse().context("an address was expected")?;
            format!("udp: '{}'", SocketAddr::new(ip, *port))
        }
        tls @ LinkTarget::Tls { .. } => bail!("{tls}: a switch reaches another one over UDP or Ethernet only"),
    };
    let switch = token.switch().context("the invitation does not say which switch to dial; have another made")?;
    let place = format!("{{{via}, switch: {switch}, dial: true}}");
    let toward =
        if role == roles::RIB { format!("rib: true\nneighbours: [{place}]") } else { format!("uplink: {place}") };
    Ok(format!("identity: {}\n{toward}\n{}", quoted(identity), domain()))
}

fn proxy(token: &Token, identity: &Path) -> String {
    let switch = token.switch().map_or(String::new(), |switch| format!(", switch: {switch}"));
    let links: Vec<_> = token.addresses().map(|to| format!("{{to: {}{switch}}}", quoted(to.to_string()))).collect();
    let (identity, links) = (quoted(identity), links.join(", "));
    format!("version: 1\nidentity: {identity}\nlinks: [{links}]\n{}", domain())
}

/// Returns a text in double quotes, which YAML and JSON parse in the same way.
pub fn quoted(text: impl Serialize) -> String {
    escape_json(&serde_json::json!(text).to_string()).into_owned()
}

fn domain() -> &'static str {
    "domain: {card: domain.card, membership: membership}\n"
}
