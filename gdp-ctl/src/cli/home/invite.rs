//! `gdp-ctl invite`: prints the line with which a machine joins the domain. It gives what the
//! options say, and nothing else.

use anyhow::bail;
use clap::Args;
use gdp_core::cert::enrollment::{ALL_MEMBERS, check_label};
use gdp_core::cert::{Claims as _, Delegation, Enrollment, Invite, TopicsOf, issue};
use gdp_core::domain::{Enrolling, Token};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::link_target::LinkTarget;
use gdp_directory::join_card;
use gdp_util::terminal::note;
use gdp_util::unix_time::unix_seconds;
use schemars::JsonSchema;
use serde::Serialize;

use super::{Home, HomeOptions, SERVER};
use crate::cli::context::Context;
use crate::cli::domain::{Issue, To};
use crate::cli::issuing::{parse_seconds, validity};

#[derive(Debug, Args)]
pub struct Options {
    /// Label of the new member: the namespace of its topics at others, such as robot7.
    label: String,
    /// Topics of the new member that others may read, such as '/camera/**'; repeat or separate by
    /// commas.
    #[arg(long, value_name = "PATTERN,…", value_delimiter = ',')]
    expose: Vec<String>,
    /// Topics that the new member gets from the server, where they are under /LABEL.
    #[arg(long, value_name = "PATTERN,…", value_delimiter = ',')]
    import: Vec<String>,
    /// Topics of others that the new member may read, such as 'robot7:/camera/**', or '*:/**' for
    /// all of all members.
    #[arg(long, value_name = "LABEL:PATTERN,…", value_delimiter = ',')]
    read: Vec<String>,
    /// Time for which the new member stays one.
    #[arg(long = "for", value_name = "TIME", default_value = "365d", value_parser = parse_seconds)]
    duration: u32,
    /// Time within which the line must be used.
    #[arg(long, value_name = "TIME", default_value = "24h", value_parser = parse_seconds)]
    within: u32,
    /// Role of the new member in grants.
    #[arg(long, default_value = "robot")]
    role: String,
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
    /// End of the membership, in Unix seconds.
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
    let Options { label, expose, import, read, role, .. } = options;
    if expose.is_empty() && import.is_empty() && read.is_empty() {
        bail!("nothing would cross: say what {label} exposes, imports or reads, such as --expose '/camera/**'");
    }
    if label == SERVER {
        bail!("{SERVER} is the label of the server's own proxy; choose another label");
    }
    expose.iter().try_for_each(|pattern| check_pattern(pattern))?;
    let import = imported(label, import)?;
    let read = read.iter().map(|text| topics_of(text)).collect::<anyhow::Result<_>>()?;
    let (label, role, expose) = (label.clone(), role.clone(), expose.clone());
    let (duration, within) = (options.duration.into(), options.within.into());
    let address = home.address()?;
    let terms = Terms { label: label.clone(), role, expose, import, read, duration, within };
    let (token, claims) = home.invite(terms, address.target()?, &address)?;
    let line = token.to_line();
    let Invite { not_after: use_until, member_until, .. } = claims;
    if !context.output.json {
        let hours = options.within / 3600;
        note(format_args!("One line, for {label}, once, within {hours} h. It holds a secret: send it as a password."));
        note(format_args!("On {label}, run `sudo gdp-proxy join` and paste it:"));
    }
    let output = InviteOutput { label, line: line.to_string(), use_until, member_until };
    context.output.print(&output, || [line.to_string()])
}

impl Home {
    /// Makes an invitation that enrolls the new member.
    pub(super) fn invite(
        &self,
        terms: Terms,
        at: LinkTarget,
        address: &super::DomainAddress,
    ) -> anyhow::Result<(Token, Invite)> {
        let Terms { label, role, expose, import, read, duration, within } = terms;
        check_label(&label)?;
        let authority = self.authority()?;
        let now = unix_seconds();
        let holds = |issue: &&Issue| {
            let is_valid = issue.state(authority.revocation.as_ref(), now) == "valid" || issue.ends > now;
            issue.label.as_ref() == Some(&label) && is_valid && !issue.is_revoked(authority.revocation.as_ref())
        };
        if authority.issued.iter().any(|issue| holds(&issue)) {
            bail!(
                "{label} is a member or invited already; choose another label, or first run `gdp-ctl revoke {label}`"
            );
        }
        let (invited, key) = (SigningKey::generate()?, authority.identity.key());
        let (domain, serial) = (authority.identity.name(), authority.serial);
        let (not_before, not_after) = validity(within.min(duration));
        let (_, member_until) = validity(duration);
        let claims = Invite {
            domain,
            key: invited.verify_key(),
            role: role.clone(),
            serial,
            not_before,
            not_after,
            member_until,
        };
        let join_service = Identity::new(SigningKey::load(&self.path("join.pem"))?, "tool").key().verify_key();
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
            not_after: member_until,
        };
        enrollment.check_bounds()?;
        let name = join_card(key.verify_key())?.name();
        let delegate = invited.verify_key();
        let call = Delegation { name, delegate, publish: false, read: true, serial, not_before, not_after };
        let enrollment = issue(key, &enrollment)?;
        self.keep_enrollment(&label, &enrollment)?;
        let enrolling = Enrolling { enrollment, call: issue(key, &call)? };
        let token = Token::new(authority.identity.proof(), issue(key, &claims)?, invited, at, Some(address.switch))?;
        let token = token.enroll(enrolling)?;
        self.record("invite", &label, &[serial])?;
        let (to, label) = (To::Invited { role }, Some(label));
        authority.remember(Issue { serial, to, label, not_before, not_after, ends: member_until, file: None })?;
        Ok((token, claims))
    }
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
    let of_server = TopicsOf { member: SERVER.into(), topics: patterns.to_vec() };
    Ok(if patterns.is_empty() { vec![] } else { vec![of_server] })
}

pub(super) fn topics_of(text: &str) -> anyhow::Result<TopicsOf> {
    let Some((member, pattern)) = text.split_once(':') else {
        bail!("--read {text}: write LABEL:PATTERN, such as robot7:/camera/**");
    };
    check_pattern(pattern)?;
    if member != ALL_MEMBERS {
        check_label(member)?;
    }
    Ok(TopicsOf { member: member.into(), topics: vec![pattern.into()] })
}

pub(super) fn check_pattern(pattern: &str) -> anyhow::Result<()> {
    Ok(gdp_ros::pattern::check(pattern).map_err(anyhow::Error::msg)?)
}
