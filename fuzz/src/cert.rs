//! Certificates, statements and name cards, as they come from a file or a peer.

use gdp_core::card::NameCard;
use gdp_core::cert::{
    AdCert, Advert, Claims, Delegation, Invite, Issued, LinkState, MemberCert, Membership, PeerCert, ReadGrant,
    Reading, Revocation, RtCert, Signed, SwitchStatement,
};
use gdp_core::domain::Token;

/// Bytes that are taken for a certificate are its only encoding, and survive their text form.
pub fn cert(data: &[u8]) {
    decode::<AdCert>(data);
    decode::<ReadGrant>(data);
    decode::<Delegation>(data);
    decode::<Revocation>(data);
    decode::<MemberCert>(data);
    decode::<Invite>(data);
    decode::<PeerCert>(data);
    decode::<RtCert>(data);
    decode::<Advert>(data);
    decode::<LinkState>(data);
    decode::<SwitchStatement>(data);
    let Ok(text) = str::from_utf8(data) else { return };
    if let Ok(issued) = Issued::<AdCert>::from_pem(text) {
        assert_eq!(Issued::from_pem(&issued.to_pem()).expect("its own text"), issued);
    }
    if let Ok(reading) = Reading::from_pem(text) {
        assert_eq!(Reading::from_pem(&reading.to_pem()).expect("its own text"), reading);
    }
    if let Ok(signed) = Signed::<Revocation>::from_pem(text) {
        assert_eq!(Signed::from_pem(&signed.to_pem()).expect("its own text"), signed);
    }
    if let Ok(member) = Membership::from_pem(text) {
        assert_eq!(Membership::from_pem(&member.to_pem()).expect("its own text"), member);
    }
    if let Ok(token) = Token::from_line(text) {
        let again = Token::from_line(&token.to_line()).expect("its own line");
        assert_eq!(again.invite().ok(), token.invite().ok());
    }
    if let Ok(card) = NameCard::from_json(text) {
        assert_eq!(NameCard::from_json(&card.to_json()).expect("its own text").name(), card.name());
    }
}

fn decode<T: Claims>(data: &[u8]) {
    let Ok(signed) = Signed::<T>::from_bytes(data.to_vec()) else { return };
    if signed.claims_unverified().is_ok() {
        let again = Signed::<T>::from_pem(&signed.to_pem()).expect("its own text");
        assert_eq!(again.as_bytes(), data);
    }
}
