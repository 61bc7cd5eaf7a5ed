//! Unit tests of `link::tls`.

use super::*;

#[test]
fn only_the_exact_form_of_a_p256_key_is_read() {
    let key = SigningKey::generate().unwrap();
    let certified = certified_key(&key).unwrap();
    let der = certified.cert[0].as_ref();
    assert_eq!(parse_spki(der).unwrap(), key.verify_key());
    for length in 0..der.len() {
        assert!(parse_spki(&der[..length]).is_err(), "{length}");
    }
    assert!(parse_spki(&[der, &[0]].concat()).is_err());
    for i in 0..SPKI_PREFIX.len() {
        let mut other = der.to_vec();
        other[i] ^= 1;
        assert!(parse_spki(&other).is_err(), "byte {i}");
    }
}
