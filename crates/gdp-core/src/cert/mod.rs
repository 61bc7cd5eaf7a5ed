//! Certificates and statements: COSE_Sign1 / ES256 over deterministic CBOR (RFC 9052, RFC 8949
//! §4.2.1). [`owner`], [`domain`], [`enrollment`], [`renewal`], [`switch`], [`statements`] and
//! [`link_state`] define the claims. [`Signed`] keeps and verifies the exact bytes. [`issued`]
//! verifies the chain from a certificate to the owner of its name, and [`membership`] that of a
//! member. [`request`] checks the signatures that a request needs. The RIB and the receivers of its
//! answers call this module.
//!
//! Domain separation: the type of a certificate is its external AAD and its protected content type,
//! so one type never verifies as another. A COSE `Sig_structure` begins with a CBOR array head and
//! "Signature1". No other input that this project signs begins so (`gdp::seal` signs
//! "gdp/batch/1…", TLS signs 64 spaces and a context).

mod advert_op;
mod allow;
mod block;
mod claims;
pub mod domain;
pub mod enrollment;
mod error;
mod extension;
mod issued;
mod link_state;
mod membership;
mod name_proof;
mod owner;
mod pem;
mod renewal;
mod request;
mod signed;
mod statements;
mod switch;

pub use advert_op::AdvertOp;
pub use allow::{AllowPublish, AllowRead};
pub use claims::{BACKDATED, CLOCKS_DIFFER, Claims, SERIAL_AHEAD, Validity, last_serial};
pub use domain::{Invite, MemberCert, PeerCert, PeerRights};
pub use enrollment::{Enrollment, TopicsOf};
pub use error::CertError;
pub use issued::{Issued, MAX_CERT_FILE, Reading};
pub use link_state::{Adjoining, LinkState, MAX_BORDERS, MAX_NEIGHBOURS};
pub use membership::Membership;
pub use owner::{AboutName, AdCert, Delegation, Grantee, MAX_REVOKED, MAX_ROLE, MAX_SCOPE, ReadGrant, Revocation};
pub use renewal::{MembershipRenewal, RenewalDelegation};
pub use request::{Requester, Side, authorise_advertise, authorise_subscribe, authorise_withdraw, verify_statement};
pub use signed::{MAX_SIGNED, Signed, issue};
pub use statements::{Advert, RtCert};
pub use switch::{Host, Locator, MAX_ADDRESSES, MAX_LOCATED, MAX_LOCATOR, SwitchStatement};

#[cfg(test)]
#[path = "../../tests/unit/cert/extension_tests.rs"]
mod extension_tests;
#[cfg(test)]
#[path = "../../tests/unit/cert/issued_tests.rs"]
mod issued_tests;
#[cfg(test)]
#[path = "../../tests/unit/cert/switch_tests.rs"]
mod switch_tests;
#[cfg(test)]
#[path = "../../tests/unit/cert.rs"]
mod tests;
