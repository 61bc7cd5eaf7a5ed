//! Enrollment of a member in the directory of its domain: its label, and the topics that it may
//! expose, import and read. Only the domain's join service and the members receive it, so switches
//! and RIBs learn no topic names.

use super::owner::check_role;
use super::{Claims, Membership, Signed, Validity};
use crate::cert::error::CertError;
use crate::name::Name;
use crate::verify_key::VerifyKey;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Maximum length of a label in bytes.
pub const MAX_LABEL: usize = 32;

/// Maximum number of patterns in one list, and of rules.
pub const MAX_PATTERNS: usize = 64;

/// Maximum length of a pattern in bytes.
const MAX_PATTERN: usize = 253;

/// Kinds of names that a pattern selects by a prefix, such as `service:/plan`. Without one it
/// selects topics.
const KINDS: [&str; 2] = ["service:", "action:"];

/// The label that stands for all members in [`TopicsOf::member`].
pub const ALL_MEMBERS: &str = "*";

/// Certificate of a domain that states the label of a member, and which topics it shares with
/// which members.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Enrollment {
    pub domain: Name,
    /// Serial of the member's [`Invite`](super::Invite) or [`MemberCert`](super::MemberCert).
    pub member: u64,
    /// Label of the member. It is also the namespace of its topics at other members.
    pub label: String,
    /// Patterns of the topics, services and actions that other members may import from this one.
    pub expose: Vec<String>,
    /// Topics that the member imports under their own names. The other member has them under
    /// `/LABEL`, with this member's label.
    pub import: Vec<TopicsOf>,
    /// Topics of other members that the member may read, under `/THEIR_LABEL`.
    pub read: Vec<TopicsOf>,
    /// Key of the join service, to which members delegate the grants for their catalogs.
    pub join_service: VerifyKey,
    pub serial: u64,
    pub not_before: u64,
    pub not_after: u64,
}

/// Patterns of topics, services and actions at one member, or at [all](ALL_MEMBERS).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TopicsOf {
    pub member: String,
    pub topics: Vec<String>,
}

impl TopicsOf {
    pub fn is_of(&self, label: &str) -> bool {
        self.member == ALL_MEMBERS || self.member == label
    }
}

impl fmt::Display for TopicsOf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.member, self.topics.join(","))
    }
}

impl FromStr for TopicsOf {
    type Err = CertError;

    /// Parses `LABEL:PATTERN`. Does not check the pattern.
    fn from_str(text: &str) -> Result<Self, CertError> {
        let Some((member, pattern)) = text.split_once(':') else {
            return Err(CertError::Malformed(format!("{text}: write LABEL:PATTERN, such as robot7:/camera/**")));
        };
        if member != ALL_MEMBERS {
            check_label(member)?;
        }
        Ok(Self { member: member.into(), topics: vec![pattern.into()] })
    }
}

/// Splits the kind from a pattern of an [`Enrollment`]: `service:`, `action:`, or nothing for
/// topics.
pub fn split_kind(pattern: &str) -> (&'static str, &str) {
    let split = |kind: &'static str| Some((kind, pattern.strip_prefix(kind)?));
    KINDS.into_iter().find_map(split).unwrap_or(("", pattern))
}

/// Returns the pattern for the same names below a namespace.
pub fn within_namespace(namespace: &str, pattern: &str) -> String {
    let (kind, pattern) = split_kind(pattern);
    format!("{kind}/{namespace}{pattern}")
}

impl Claims for Enrollment {
    const KIND: &'static str = "Enrollment";
    const LABEL: &'static str = "GDP ENROLLMENT";
    const CONTEXT: &'static str = "application/vnd.gdp.enrollment.v1+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: self.not_before, not_after: self.not_after }
    }

    fn issued_at(&self) -> Option<u64> {
        Some(self.serial)
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        check_label(&self.label)?;
        check_lists(&self.expose, &self.import, &self.read)?;
        self.validity().check_order()
    }
}

/// Checks the bounds of the lists of an [`Enrollment`].
pub fn check_lists(expose: &[String], import: &[TopicsOf], read: &[TopicsOf]) -> Result<(), CertError> {
    let rules = import.iter().chain(read);
    for TopicsOf { member, .. } in rules.clone().filter(|of| of.member != ALL_MEMBERS) {
        check_label(member)?;
    }
    let lists = rules.map(|of| &of.topics[..]).chain([expose]);
    let too_many = |count| count > MAX_PATTERNS;
    if too_many(import.len()) || too_many(read.len()) || lists.clone().any(|list| too_many(list.len())) {
        return Err(CertError::Malformed(format!("more than {MAX_PATTERNS} patterns or members in one list")));
    }
    let is_bad = |pattern: &String| pattern.len() > MAX_PATTERN || pattern.chars().any(char::is_control);
    if lists.flatten().any(is_bad) {
        return Err(CertError::Malformed(format!(
            "a pattern has at most {MAX_PATTERN} bytes, without control characters"
        )));
    }
    Ok(())
}

/// Checks that a text is a label: a segment of a ROS name of at most [`MAX_LABEL`] bytes.
pub fn check_label(label: &str) -> Result<(), CertError> {
    let is_ros = label.starts_with(|c: char| c.is_ascii_lowercase()) && !label.contains('-');
    if is_ros && check_role(label).is_ok() {
        return Ok(());
    }
    Err(CertError::Malformed(format!(
        "a label is the namespace of the member's topics: 1 to {MAX_LABEL} of a-z, 0-9 and _, with a letter first"
    )))
}

impl Signed<Enrollment> {
    /// Verifies that the domain of `membership` enrolled this member, at `now` (Unix seconds).
    /// Returns the member's entity and the claims. The caller checks revocations.
    pub fn verify_for(&self, domain: Name, membership: &Membership, now: u64) -> Result<(Name, Enrollment), CertError> {
        let member = membership.verify(domain, None, now)?;
        let claims = self.verify_for_name(&membership.domain)?;
        claims.check_time(now)?;
        // A retired key cannot change what its successor's members share.
        let first = membership.domain.verify_key()?;
        if self.signer_unverified()? == first && membership.signer_unverified()? != first {
            let signer = membership.signer_unverified()?.to_string();
            return Err(CertError::Retired { what: Enrollment::KIND, signer });
        }
        if claims.domain != domain {
            return Err(CertError::WrongDomain { expected: domain, got: claims.domain });
        }
        if claims.member != membership.serial_unverified()? {
            return Err(CertError::Malformed("the enrollment is of another member".into()));
        }
        Ok((member.entity, claims))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/cert/enrollment.rs"]
mod tests;
