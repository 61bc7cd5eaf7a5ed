//! `gdp-ctl invite`: prints the line with which a machine joins the domain. It gives what the
//! options say, and nothing else.

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::cert::domain::roles;
use gdp_core::cert::enrollment::{check_label, split_kind};
use gdp_core::cert::{Delegation, Enrollment, Invite, Signed, TopicsOf, issue};
use gdp_core::domain::{Enrolling, Token};
use gdp_core::identity::{SigningKey, VerifyKey};
use gdp_core::link_target::LinkTarget;
use gdp_directory::{SERVER, join_card, of_server};
use gdp_util::date::rounded;
use gdp_util::terminal::note;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::renewals::{RENEWABLE, delegate_renewal};
use super::{APPLICANTS, DAY, Home, HomeOptions, files};
use crate::cli::context::Context;
use crate::cli::domain::{Issue, To};
use crate::cli::entity::parse_entity;
use crate::cli::issuing::{parse_seconds, validity};

#[derive(Debug, Args)]
pub struct Options {
    /// Label of the new member: the namespace of its topics at others, such as robot7. Without a
    /// label, the line is for any number of machines, which wait until you approve them.
    label: Option<String>,
    /// Topics of the new member that others may read, such as '/camera/**', and services and
    /// actions that they may call, such as service:/plan; repeat or separate by commas.
    #[arg(long, value_name = "PATTERN,…", value_delimiter = ',')]
    expose: Vec<String>,
    /// Topics, services and actions that the new member gets from the server, where they are under
    /// /LABEL.
    #[arg(long, value_name = "PATTERN,…", value_delimiter = ',')]
    import: Vec<String>,
    /// Topics of others that the new member may read, such as 'robot7:/camera/**', or '*:/**' for
    /// all of all members. Services and actions as in robot7:service:/plan.
    #[arg(long, value_name = "LABEL:PATTERN,…", value_delimiter = ',')]
    read: Vec<String>,
    /// Time for which the new member stays one. Default: until it is revoked, and for a line
    /// without a label a year.
    #[arg(long = "for", value_name = "TIME", value_parser = parse_seconds)]
    duration: Option<u32>,
    /// Time within which the line must be used.
    #[arg(long, value_name = "TIME", default_value = "24h", value_parser = parse_seconds)]
    within: u32,
    /// Role of the new member in grants.
    #[arg(long, default_value = "robot")]
    role: String,
    /// Address of another switch of the domain that the new member dials, such as
    /// udp://192.0.2.7:31415. Default: that of `gdp-ctl up`.
    #[arg(long, value_name = "LINK", requires = "switch")]
    at: Option<LinkTarget>,
    /// Switch at that address: its name, as printed by `gdp-ctl status` there, or its key file.
    #[arg(long, value_name = "NAME|FILE", requires = "at", value_parser = parse_entity)]
    switch: Option<Name>,
    #[command(flatten)]
    home: HomeOptions,
}

/// Output of `gdp-ctl invite`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct InviteOutput {
    label: String,
    /// The line. It is a secret.
    line: String,
    /// Last Unix second at which the line can be used.
    use_until: u64,
    /// End of the membership without a renewal, in Unix seconds.
    member_until: u64,
}

/// What a new member gets.
pub(super) struct Terms {
    pub label: String,
    pub role: String,
    pub expose: Vec<String>,
    pub import: Vec<TopicsOf>,
    pub read: Vec<TopicsOf>,
    /// Seconds for which the member stays one.
    pub duration: u64,
    /// Seconds within which the line must be used.
    pub within: u64,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let home = options.home.home()?;
    let address = home.address()?;
    let terms = options.terms()?;
    let (label, is_standing) = (terms.label.clone(), terms.role == roles::APPLICANT);
    let at = options.at.clone().map_or_else(|| address.target(), Ok)?;
    let (token, claims) = home.invite(terms, at, options.switch.unwrap_or(address.switch))?;
    let token = if options.at.is_none() { token.also(address.tls_targets()?) } else { token };
    let line = token.to_line();
    let Invite { not_after: use_until, member_until, .. } = claims;
    if !context.output.json {
        if is_standing {
            note("Machines that run `sudo gdp-proxy join` with this line wait until you approve them.");
        } else {
            let within = rounded(options.within.into());
            note(format_args!(
                "One line, for {label}, once, within {within}. It holds a secret: send it as a password."
            ));
            note(format_args!("On {label}, run `sudo gdp-proxy join` and paste it:"));
        }
    }
    let output = InviteOutput { label, line: line.to_string(), use_until, member_until };
    context.output.print(&output, || [line.to_string()])
}

impl Options {
    /// Returns what the new member gets. Without a label, machines may only ask.
    fn terms(&self) -> anyhow::Result<Terms> {
        let Self { label, expose, import, read, role, .. } = self;
        let is_empty = expose.is_empty() && import.is_empty() && read.is_empty();
        let (duration, within) = (self.duration.map(u64::from), self.within.into());
        let Some(label) = label else {
            if !is_empty {
                bail!("without a label, machines ask for topics themselves; name the label, or leave the topics out");
            }
            let (label, role) = (APPLICANTS.to_owned(), roles::APPLICANT.to_owned());
            let duration = duration.unwrap_or(365 * DAY);
            return Ok(Terms { label, role, expose: vec![], import: vec![], read: vec![], duration, within: duration });
        };
        let duration = duration.unwrap_or(RENEWABLE);
        if is_empty {
            bail!("nothing would cross: say what {label} exposes, imports or reads, such as --expose '/camera/**'");
        }
        check_free(label)?;
        expose.iter().try_for_each(|pattern| check_pattern(pattern))?;
        Ok(Terms {
            label: label.clone(),
            role: role.clone(),
            expose: expose.clone(),
            import: imported(label, import)?,
            read: read.iter().map(|text| topics_of(text)).collect::<anyhow::Result<_>>()?,
            duration,
            within,
        })
    }
}

impl Home {
    /// Makes an invitation that enrolls the new member.
    pub(super) fn invite(&self, terms: Terms, at: LinkTarget, switch: Name) -> anyhow::Result<(Token, Invite)> {
        let invited = SigningKey::generate()?;
        let (invite, enrolling, claims) = self.sign_invitation(terms, invited.verify_key())?;
        let card = self.card()?;
        let token = Token::new(card.proof(), invite, invited, at, Some(switch))?;
        Ok((token.with_successor(card.successor()).enroll(enrolling)?, claims))
    }

    /// Signs an invitation to a key, and stores what was issued.
    pub(super) fn sign_invitation(
        &self,
        terms: Terms,
        invited: VerifyKey,
    ) -> anyhow::Result<(Signed<Invite>, Enrolling, Invite)> {
        let Terms { label, role, expose, import, read, duration, within } = terms;
        check_label(&label)?;
        let authority = self.authority()?;
        let open = self.open_serials(&authority.ledger)?;
        let holds = |issue: &Issue| issue.label.as_ref() == Some(&label) && open.contains(&issue.serial);
        if authority.ledger.issued.iter().any(holds) {
            bail!(
                "{label} is a member or invited already; choose another label, or first run `gdp-ctl revoke {label}`"
            );
        }
        let (key, domain, serial) = (authority.identity.key(), authority.identity.name(), authority.serial);
        let (not_before, not_after) = validity(within.min(duration));
        // The first membership. Renewals follow it for the whole duration.
        let lifetime = self.address()?.lifetime;
        let (_, member_until) = validity(duration.min(within + lifetime));
        let (_, ends) = validity(duration);
        let claims = Invite { domain, key: invited, role: role.clone(), serial, not_before, not_after, member_until };
        let join_key = SigningKey::load(&self.path("join.pem"))?;
        let join_service = join_key.verify_key();
        let enrollment = Enrollment {
            domain,
            member: serial,
            label: label.clone(),
            expose,
            import,
            read,
            join_service,
            serial,
            not_before,
            not_after: ends,
        };
        let name = join_card(join_service)?.name();
        let call = Delegation { name, delegate: invited, publish: false, read: true, serial, not_before, not_after };
        let (invite, enrollment) = (issue(key, &claims)?, issue(key, &enrollment)?);
        let enrolling = Enrolling { enrollment, call: issue(&join_key, &call)? };
        self.record("invite", &label, &[serial])?;
        if role != roles::APPLICANT {
            self.keep_signed(files::ENROLLMENTS, [(label.clone(), enrolling.enrollment.to_pem())])?;
            if ends > member_until {
                let renewal = delegate_renewal(&authority, join_service, serial, lifetime, ends)?;
                self.keep_signed(files::RENEWALS, [(label.clone(), renewal.to_pem())])?;
            }
        }
        let (to, label) = (To::Invited { role }, Some(label));
        authority.remember(Issue { serial, to, label, not_before, not_after, ends, file: None })?;
        Ok((invite, enrolling, claims))
    }
}

/// Checks that a text is a label that a member may have.
pub(super) fn check_free(label: &str) -> anyhow::Result<()> {
    check_label(label)?;
    if [SERVER, APPLICANTS].contains(&label) {
        bail!("{label} is a label that the domain uses itself; choose another label");
    }
    Ok(())
}

/// Returns the topics that a member imports from the server.
pub(super) fn imported(label: &str, patterns: &[String]) -> anyhow::Result<Vec<TopicsOf>> {
    for pattern in patterns {
        check_pattern(pattern)?;
        if pattern.split('/').nth(1).is_none_or(|part| part.contains('*')) {
            bail!(
                "import {pattern}: begin with a segment without *, because {label} has the topics under their own names"
            );
        }
    }
    Ok(of_server(patterns))
}

pub(super) fn topics_of(text: &str) -> anyhow::Result<TopicsOf> {
    let of: TopicsOf = text.parse().context("--read")?;
    of.topics.iter().try_for_each(|pattern| check_pattern(pattern))?;
    Ok(of)
}

pub(super) fn check_pattern(pattern: &str) -> anyhow::Result<()> {
    gdp_ros::pattern::check(split_kind(pattern).1).map_err(anyhow::Error::msg)
}
