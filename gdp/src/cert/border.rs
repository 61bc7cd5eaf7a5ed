//! Where a domain can be reached: what each of its border switches states of itself, and what shows that it is one.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

use super::domain::roles;
use super::{CertError, Claims, Membership, Revocation, Signed, Validity};
use crate::name::{Name, NameProof};

/// Addresses of one border switch.
pub const MAX_ADDRESSES: usize = 8;

/// Border switches of one domain that are told of.
pub const MAX_LOCATED: usize = 8;

/// Bytes of all that is signed in a locator.
pub const MAX_LOCATOR: usize = 16 << 10;

/// A border switch → other domains: here you reach me. Signed by its own key; of a switch the highest serial counts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BorderStatement {
    pub switch: Name,
    pub domain: Name,
    /// Best first. None if it can only dial.
    pub addresses: Vec<SocketAddr>,
    pub serial: u64,
    /// The last Unix second at which it holds.
    pub not_after: u64,
}

impl Claims for BorderStatement {
    const KIND: &'static str = "BorderStatement";
    const LABEL: &'static str = "GDP BORDER STATEMENT";
    const CONTEXT: &'static str = "application/vnd.gdp.border-statement.v1+cbor";

    fn validity(&self) -> Validity {
        Validity { not_before: 0, not_after: self.not_after }
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        let count = self.addresses.len();
        if count > MAX_ADDRESSES {
            return Err(CertError::Malformed(format!("{count} addresses where at most {MAX_ADDRESSES} are allowed")));
        }
        Ok(())
    }
}

/// One border switch, as any domain may judge it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Border {
    /// How the name of the switch is derived, and its key.
    pub proof: NameProof,
    pub statement: Signed<BorderStatement>,
    pub membership: Membership,
}

impl Border {
    /// What the switch states, if it is a border of `domain` at `now` (Unix seconds) and signed this. `revocation` is the newest that is
    /// known of the domain. What is returned ends with all that it rests on.
    pub fn verify(
        &self,
        domain: Name,
        revocation: Option<&Revocation>,
        now: u64,
    ) -> Result<BorderStatement, CertError> {
        let member = self.membership.verify(domain, revocation, now)?;
        if member.role != roles::BORDER {
            return Err(CertError::WrongRole { expected: roles::BORDER.into(), got: member.role });
        }
        let switch = self.proof.name()?;
        if member.entity != switch {
            return Err(CertError::WrongEntity { expected: switch, got: member.entity });
        }
        let mut claims = self.statement.verify(&self.proof.verify_key()?, now)?;
        if claims.switch != switch {
            return Err(CertError::WrongSwitch { expected: switch, got: claims.switch });
        }
        if claims.domain != domain {
            return Err(CertError::WrongDomain { expected: domain, got: claims.domain });
        }
        claims.not_after = claims.not_after.min(member.not_after);
        Ok(claims)
    }

    fn size(&self) -> usize {
        self.statement.as_bytes().len() + self.membership.size()
    }
}

/// Where a domain can be reached: candidates, best first. Each stands for itself: whoever receives it leaves out those that do not verify,
/// because one border whose membership is over must not hide the others. One that names too many, or of which none is left, says nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Locator {
    pub borders: Vec<Border>,
}

impl Locator {
    /// As [`Border::verify`], of each by itself. The error: they are more than allowed.
    pub fn verify(
        &self,
        domain: Name,
        revocation: Option<&Revocation>,
        now: u64,
    ) -> Result<Vec<Result<BorderStatement, CertError>>, CertError> {
        let (count, size) = (self.borders.len(), self.size());
        if count > MAX_LOCATED || size > MAX_LOCATOR {
            return Err(CertError::Malformed(format!(
                "{count} borders, {size} bytes in all, where {MAX_LOCATED} and {MAX_LOCATOR} are allowed"
            )));
        }
        Ok(self.borders.iter().map(|border| border.verify(domain, revocation, now)).collect())
    }

    /// Bytes of what is signed in it.
    pub fn size(&self) -> usize {
        self.borders.iter().map(Border::size).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cbor;
    use crate::cert::{MemberCert, issue};
    use crate::identity::{Identity, SigningKey};

    #[test]
    fn a_border_is_believed_only_if_all_of_it_fits() {
        let (domain, switch, other) = (identity(1, "domain"), identity(2, "switch"), identity(3, "switch"));
        let member = |entity: &Identity, role: &str| {
            let (domain_name, entity, role) = (domain.name(), entity.name(), role.into());
            let cert = MemberCert { domain: domain_name, entity, role, serial: 7, not_before: 100, not_after: 200 };
            Membership::issue(&domain, &cert).unwrap()
        };
        let addresses = vec!["192.0.2.1:31415".parse().unwrap(), "[2001:db8::1]:31415".parse().unwrap()];
        let claims =
            BorderStatement { switch: switch.name(), domain: domain.name(), addresses, serial: 1, not_after: 500 };
        let right = Border {
            proof: switch.proof(),
            statement: issue(switch.key(), &claims).unwrap(),
            membership: member(&switch, roles::BORDER),
        };
        let verified = right.verify(domain.name(), None, 150).unwrap();
        assert_eq!(verified, BorderStatement { not_after: 200, ..claims.clone() });
        let bytes = cbor::encode(&right).unwrap();
        assert_eq!(cbor::decode::<Border>(&bytes, bytes.len()).unwrap(), right);

        let revoked = Revocation { name: domain.name(), number: 1, floor: 8, revoked: vec![] };
        assert!(matches!(right.verify(domain.name(), Some(&revoked), 150), Err(CertError::Revoked { .. })));
        assert!(matches!(right.verify(domain.name(), None, 201), Err(CertError::Expired { .. })));
        assert!(matches!(right.verify(other.name(), None, 150), Err(CertError::WrongDomain { .. })));
        let with = |change: &dyn Fn(&mut Border)| {
            let mut border = right.clone();
            change(&mut border);
            border.verify(domain.name(), None, 150).unwrap_err()
        };
        let states = |key: &Identity, claims: BorderStatement| issue(key.key(), &claims).unwrap();
        for (what, error, expected) in [
            ("role", with(&|b| b.membership = member(&switch, roles::SWITCH)), "wrong role"),
            ("another's membership", with(&|b| b.membership = member(&other, roles::BORDER)), "wrong entity"),
            ("another's signature", with(&|b| b.statement = states(&other, claims.clone())), "wrong key"),
            (
                "of another switch",
                with(&|b| b.statement = states(&switch, BorderStatement { switch: other.name(), ..claims.clone() })),
                "wrong switch",
            ),
            (
                "of another domain",
                with(&|b| b.statement = states(&switch, BorderStatement { domain: other.name(), ..claims.clone() })),
                "wrong domain",
            ),
        ] {
            assert!(error.to_string().contains(expected), "{what}: {error}");
        }
        let many = Locator { borders: vec![right.clone(); MAX_LOCATED + 1] };
        assert!(matches!(many.verify(domain.name(), None, 150), Err(CertError::Malformed(_))));
        let crowded = BorderStatement { addresses: vec![claims.addresses[0]; MAX_ADDRESSES + 1], ..claims };
        assert!(issue(switch.key(), &crowded).is_err());
    }

    fn identity(seed: u8, kind: &str) -> Identity {
        Identity::new(SigningKey::for_test(seed), kind)
    }
}
