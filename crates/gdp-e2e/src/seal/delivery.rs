//! Delivery: what happens to a message whose segments are all open. The signature is checked here,
//! and only then does the message count.

use super::DropReason;
use super::assembly::{Assembled, Assembly};
use super::message::{Message, Preamble};
use super::signed_parts::{SignedParts, check_age, unsigned};
use super::source::WriterState;
use super::wire::{self, Kind, Proof, SegmentHeader};
use crate::seal::event::{Lost, Push, ReaderContext};
use bytes::Bytes;
use gdp_core::crypto::CryptoError;
use std::borrow::Cow;

impl WriterState {
    pub(super) fn deliver_if_complete(
        &mut self,
        push: &mut Push<'_>,
        at: usize,
        header: &SegmentHeader,
    ) -> Result<(), DropReason> {
        let assemblies = &mut self.sessions[at].assemblies;
        let place = (header.sequence, header.cut);
        if !assemblies.get(&place).is_some_and(Assembly::is_complete) {
            return Ok(());
        }
        let assembly = assemblies.remove(&place).ok_or(DropReason::Internal)?;
        self.free(push.shared, assembly.cost);
        let Some(Assembled { plaintext, digests, proof, commitment }) = assembly.into_message() else {
            return lose(push, header, Err(DropReason::BadMessage));
        };
        let (_, proof) = Proof::split(&proof).ok_or(DropReason::Internal)?;
        let signed = SignedParts { commitment, digests: &digests, proof };
        self.deliver(push, at, header, Cow::Owned(plaintext), signed)
    }

    /// Delivers complete and opened messages, if the writer signed them and they are still wanted.
    pub(super) fn deliver(
        &mut self,
        push: &mut Push<'_>,
        at: usize,
        header: &SegmentHeader,
        plaintext: Cow<'_, [u8]>,
        signed: SignedParts<'_>,
    ) -> Result<(), DropReason> {
        let result = self.deliver_signed(push, at, header, plaintext, signed);
        lose(push, header, result)
    }

    fn deliver_signed(
        &mut self,
        push: &mut Push<'_>,
        at: usize,
        header: &SegmentHeader,
        plaintext: Cow<'_, [u8]>,
        signed: SignedParts<'_>,
    ) -> Result<(), DropReason> {
        let ReaderContext { name, limits, .. } = &*push.shared;
        let max_message = limits.max_message;
        let SignedParts { commitment, digests, proof } = signed;
        let leaf = wire::leaf(&commitment, (name, &self.name), header, digests);
        let is_signed = |root: &[u8; 32]| -> Result<(), CryptoError> {
            self.verifier.verify(&wire::batch_statement(root), proof.signature)
        };
        self.signed.verify(leaf, proof.position, proof.path, is_signed).map_err(unsigned)?;
        if header.kind != Kind::Bundle {
            let preamble = Preamble::parse(&plaintext)?;
            if preamble.body.len() > max_message {
                return Err(DropReason::TooLarge);
            }
            check_age(push, preamble.timestamp_ns)?;
            self.accept(push.shared, at, header.sequence)?;
            let bytes = match plaintext {
                Cow::Owned(plaintext) => Bytes::from(plaintext),
                Cow::Borrowed(plaintext) => Bytes::copy_from_slice(plaintext),
            };
            self.announce(push, header, header.sequence, preamble, &bytes, 0);
            return Ok(());
        }
        let messages = Preamble::parse_bundle(&plaintext, header.count)?;
        if messages.iter().any(|message| message.body.len() > max_message) {
            return Err(DropReason::TooLarge);
        }
        messages.first().map_or(Ok(()), |first| check_age(push, first.timestamp_ns))?;
        let from = self.sessions[at].from.unwrap_or(0);
        for (sequence, message) in (header.sequence..).zip(messages) {
            // Some may have come before, in another cut.
            if sequence < from || self.accept(push.shared, at, sequence).is_err() {
                continue;
            }
            // Each has memory of its own, so that one that is kept does not keep all.
            let start = if message.origin.is_empty() { message.body.start } else { message.origin.start };
            let bytes = Bytes::copy_from_slice(&plaintext[start..message.body.end]);
            self.announce(push, header, sequence, message, &bytes, start);
        }
        Ok(())
    }

    /// Appends a delivered message to the output. `bytes` is the plaintext from `start` on.
    fn announce(
        &self,
        push: &mut Push<'_>,
        header: &SegmentHeader,
        sequence: u64,
        preamble: Preamble,
        bytes: &Bytes,
        start: usize,
    ) {
        let Preamble { timestamp_ns, encoding, in_reply_to, origin, latched, service, body } = preamble;
        let origin =
            if origin.is_empty() { Bytes::new() } else { bytes.slice(origin.start - start..origin.end - start) };
        push.out.messages.push(Message {
            name: push.shared.name,
            writer: self.name,
            session: header.session,
            sequence,
            timestamp_ns,
            encoding,
            in_reply_to,
            origin,
            latched,
            service,
            body: bytes.slice(body.start - start..body.end - start),
        });
    }
}

/// Reports the messages of a dropped segment as lost.
fn lose(push: &mut Push<'_>, header: &SegmentHeader, result: Result<(), DropReason>) -> Result<(), DropReason> {
    if let Err(reason) = result {
        let again = !matches!(reason, DropReason::TooOld | DropReason::TooLarge);
        let lost = (header.sequence..).take(header.messages() as usize);
        push.out.lost.extend(lost.map(|sequence| Lost { session: header.session, sequence, again }));
    }
    result
}
