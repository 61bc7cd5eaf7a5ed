//! An issuer of grants: the key of a name's owner or of a delegate, with the ledger of the name.

use std::path::Path;

use anyhow::{Context as _, bail};
use gdp_core::card::NameCard;
use gdp_core::cert::{AboutName, Claims, Delegation, Issued, Revocation, Signed, Validity, issue};
use gdp_core::identity::SigningKey;
use gdp_util::unix_time::unix_seconds;

use super::super::credential_file::IssuedOutput;
use super::super::issuance_log::IssuanceLog;
use super::super::revocation::next_serial;
use super::ledger::Grant;
use crate::cli::issuing::validity;
use gdp::unstable::called;

/// The issuer, and the common properties of the certificates that it issues now.
pub struct Issuer<'b> {
    pub card: &'b NameCard,
    pub key: SigningKey,
    delegation: Option<Signed<Delegation>>,
    revocation: Option<Revocation>,
    pub grants: Vec<Grant>,
    pub serial: u64,
    pub validity: Validity,
}

impl<'b> Issuer<'b> {
    /// Opens the key for certificates of `lifetime` seconds. `card` is the path of the ledger's
    /// card. A delegate shows its delegation, with the file that it is from.
    pub fn open(
        key_file: &Path,
        card_file: &Path,
        issuance_log: &'b IssuanceLog,
        delegation: Option<(&Path, Signed<Delegation>)>,
        lifetime: u32,
    ) -> anyhow::Result<Self> {
        let (card, key) = (issuance_log.card(), SigningKey::load(key_file)?);
        let (grants, revocation) =
            (issuance_log.ledger::<Grant>()?, issuance_log.revocation()?.map(|(_, revocation)| revocation));
        let mut serial = next_serial(&grants, revocation.as_ref())?;
        let (not_before, not_after) = validity(u64::from(lifetime));
        let mut validity = Validity { not_before, not_after };
        let delegation = match delegation {
            Some((file, signed)) => {
                let claims =
                    signed.verify(card.owner_key(), unix_seconds()).with_context(|| file.display().to_string())?;
                if claims.delegate != key.verify_key() {
                    bail!("{} is for another key than {}", file.display(), key_file.display());
                }
                validity = validity.and(claims.validity());
                serial = serial.max(claims.serial);
                Some(signed)
            }
            None if key.verify_key() != *card.owner_key() => bail!(
                "{} is not the owner's key of {} ({}); use that one, or add --delegation as a delegate",
                key_file.display(),
                card_file.display(),
                called(card)
            ),
            None => None,
        };
        Ok(Self { card, key, delegation, revocation, grants, serial, validity })
    }

    /// Returns the text of a certificate and its output. Fails if the recipient would refuse the
    /// certificate.
    pub fn issue<T: AboutName>(&self, claims: &T, file: &Path) -> anyhow::Result<(String, IssuedOutput)> {
        let issued = Issued { cert: issue(&self.key, claims)?, delegation: self.delegation.clone() };
        issued.verify(&self.card.proof(), self.revocation.as_ref(), unix_seconds())?;
        Ok((issued.to_pem(), IssuedOutput::new(claims, self.serial, file)))
    }
}
