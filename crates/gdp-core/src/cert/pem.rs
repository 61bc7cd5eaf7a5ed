//! Parser of text with several blocks of RFC 7468. The callers decode the content of the blocks.

use super::MAX_SIGNED;
use super::block::wrong_label;
use crate::cert::error::CertError;
use std::collections::VecDeque;

/// Maximum number of blocks in one file: a grant, a delegation, a member's certificate, an
/// invitation, a renewal of two blocks, a domain's proof.
const MAX_BLOCKS: usize = 7;

/// Start of the labels of later kinds that a reader of this release may skip. A file may have as
/// many of these as of all others.
const OPTIONAL: &str = "GDP OPTIONAL ";

/// Maximum bytes of text. Base64 and its line breaks need less than twice the bytes.
pub(super) const MAX_TEXT: usize = 2 * MAX_BLOCKS * 2 * MAX_SIGNED;

/// Blocks of a text in their order, each with its label.
pub(super) struct Blocks<'t>(VecDeque<(&'t str, &'t str)>);

impl<'t> Blocks<'t> {
    /// Splits a text into blocks. Only blank lines may surround the blocks. Skips optional ones.
    pub fn of(text: &'t str) -> Result<Self, CertError> {
        if text.len() > MAX_TEXT {
            return Err(CertError::Malformed(format!("{} characters of text are too many", text.len())));
        }
        let (mut blocks, mut taken, mut skipped) = (VecDeque::new(), 0, 0);
        let mut rest = text.trim_ascii();
        while !rest.is_empty() {
            let none =
                || CertError::Malformed("not a certificate file: no line \"-----BEGIN …-----\" at its start".into());
            let (label, _) = rest.strip_prefix("-----BEGIN ").and_then(|l| l.split_once("-----")).ok_or_else(none)?;
            let end = format!("-----END {label}-----");
            let at = rest.find(&end).ok_or_else(|| CertError::Malformed(format!("no line \"{end}\"")))? + end.len();
            let is_optional = label.starts_with(OPTIONAL);
            let count = if is_optional { &mut skipped } else { &mut taken };
            *count += 1;
            if *count > MAX_BLOCKS {
                return Err(CertError::Malformed(format!("more than {MAX_BLOCKS} blocks")));
            }
            if !is_optional {
                blocks.push_back((label, &rest[..at]));
            }
            rest = rest[at..].trim_ascii_start();
        }
        Ok(Self(blocks))
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Removes and returns the next block, which must have this label.
    pub fn take(&mut self, label: &str) -> Result<&'t str, CertError> {
        let found = self.0.front().map(|(found, _)| *found);
        self.take_if(label).ok_or_else(|| wrong_label(label, found))
    }

    /// Removes and returns the next block, if it has this label.
    pub fn take_if(&mut self, label: &str) -> Option<&'t str> {
        self.0.front().filter(|(found, _)| *found == label)?;
        self.0.pop_front().map(|(_, block)| block)
    }

    /// Checks that no block is left.
    pub fn end(&self) -> Result<(), CertError> {
        match self.0.front() {
            Some((label, _)) => Err(CertError::Malformed(format!("\"BEGIN {label}\" does not belong in this file"))),
            None => Ok(()),
        }
    }
}
