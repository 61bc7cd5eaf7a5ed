//! Unit tests of `rib::journal`.

use super::*;

#[test]
fn every_item_has_one_key_and_nothing_else_is_one() {
    let [a, b, c] = [1, 2, 3].map(|i| Name::from_bytes([i; 32]));
    let place = |role| Item::Registration(RecordKey { name: a, role, entity: b, switch: c });
    let mut items = vec![
        Item::Floor,
        Item::Switch(a),
        Item::Revocation(a),
        Item::Invitation(u64::MAX),
        Item::Entity(b),
        Item::KeyBox { name: a, writer: b, epoch: 7, reader: c },
    ];
    items.extend(NameRole::ALL.map(place));
    let keys: BTreeSet<String> = items.iter().map(Item::to_string).collect();
    assert_eq!(keys.len(), items.len());
    for item in items {
        assert_eq!(item.to_string().parse(), Ok(item));
    }
    let upper = format!("entity/{}", a.to_string().replace('0', "A"));
    for other in ["", "floor/", "leader", "entity/12", "invitation/+7", "invitation/07", "registration/1/2/3/4", &upper]
    {
        assert_eq!(other.parse::<Item>(), Err(NoItem), "{other:?}");
    }
}
