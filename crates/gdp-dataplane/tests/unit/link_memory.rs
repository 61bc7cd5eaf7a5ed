//! Unit tests of `link_memory`.

use super::*;
use gdp_wire::replay;

#[test]
fn links_have_memory_of_their_own_and_a_new_one_begins_with_nothing() {
    let memory = LinkMemory::new();
    let (a, b) = (0x1000_0001, 0x1000_0002);
    assert!(replay::take(memory.window(a), 5) && replay::take(memory.window(b), 5));
    assert_eq!((memory.next_count(a), memory.next_count(a), memory.next_count(b)), (1, 2, 1));
    let successor = a ^ 0x2000_0000;
    memory.begin(successor);
    assert_eq!(memory.next_count(successor), 1);
    assert!(memory.may_send_error(a));
    memory.send_error(a);
    assert!(!memory.may_send_error(a) && memory.may_send_error(b), "each has its rate");
    assert!(memory.may_punt(a), "probes have another");
    memory.punt(a);
    assert!(!memory.may_punt(a) && memory.may_punt(b));
    memory.forgive(a);
    assert!(memory.may_send_error(a) && memory.may_punt(a));
    assert!(replay::take(memory.window(successor), 5));
    assert!(!replay::take(memory.window(b), 5));
}
