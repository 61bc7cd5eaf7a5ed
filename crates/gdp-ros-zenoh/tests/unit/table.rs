//! Tests of [`super`].

use super::*;

#[test]
fn a_graph_is_bounded_and_forgets() {
    let token = |id: usize| format!("@ros2_lv/0/ab/0/{id}/NN/%/%/n");
    let mut table = Table::default();
    for id in 0..MAX_TOKENS {
        table.insert(&token(id)).unwrap();
    }
    assert_eq!(table.insert(&token(MAX_TOKENS)), Err(TokenError::Full));
    assert_eq!(table.insert(&token(0)), Ok(()), "it is there already");
    table.remove(&token(0));
    assert_eq!(table.insert(&token(MAX_TOKENS)), Ok(()));
    assert_eq!(table.insert("@ros2_lv/0/ab"), Err(TokenError::Malformed));
    assert_eq!(table.snapshot().entities.len(), MAX_TOKENS);
}
