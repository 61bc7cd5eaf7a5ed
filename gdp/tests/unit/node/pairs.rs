//! Unit tests of `node::pairs`.

use super::*;
use gdp_e2e::feedback_wire::Wants;

#[test]
fn counterparts_are_kept_as_long_as_a_name_needs_them() {
    let (own, peer) = (Identity::generate("proxy").unwrap(), Identity::generate("proxy").unwrap());
    let (pairs, theirs) = (Pairs::new(own.clone()), Pairs::new(peer.clone()));
    let hello = Feedback::Hello { name: own.name(), challenge: [1; 16], wants: Wants::Every };
    let mut payload = Vec::new();
    assert!(pairs.seal(&peer.name(), std::slice::from_ref(&hello), &mut payload).is_none());
    pairs.introduce(peer.name(), peer.box_public());
    pairs.introduce(peer.name(), peer.box_public());
    theirs.introduce(own.name(), own.box_public());
    pairs.seal(&peer.name(), std::slice::from_ref(&hello), &mut payload).unwrap().unwrap();
    assert_eq!(theirs.open(&own.name(), &payload), Some(Ok(vec![hello])));
    assert_eq!(theirs.open(&own.name(), &payload), Some(Err(PairError::Replayed)));
    pairs.part(&peer.name());
    assert!(pairs.counterparts.lock().contains_key(&peer.name()));
    pairs.part(&peer.name());
    pairs.part(&peer.name());
    assert!(pairs.counterparts.lock().is_empty());
}
