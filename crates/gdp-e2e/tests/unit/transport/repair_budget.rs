use super::*;

const FRAME: u64 = 1_000;
const SECOND: u64 = 1_000 * MS;

/// Returns the bytes of as many repairs as are allowed at once.
fn all(budget: &mut RepairBudget, now: u64, fresh: Fresh, is_lagging: bool) -> u64 {
    let mut repaired = 0;
    while budget.pay(now, FRAME, fresh, is_lagging) {
        repaired += FRAME;
    }
    repaired
}

fn sent(total: u64, recent: u64) -> Fresh {
    Fresh { total, recent }
}

#[test]
fn a_quarter_of_what_was_sent_may_be_sent_again() {
    for (is_lagging, share) in [(false, 4), (true, 16)] {
        let mut budget = RepairBudget::new(0, 500);
        let at_first = all(&mut budget, 0, sent(500, 0), is_lagging);
        assert!(at_first.abs_diff(LEAST as u64) < 5_000, "{at_first}");
        // Also a message that was sent seconds ago, with nothing behind it.
        let repaired = all(&mut budget, 3 * SECOND, sent(6_000_500, 6_000_000), is_lagging);
        assert!((6_000_000 / share..6_000_000 / share + 2 * LEAST as u64).contains(&repaired), "{repaired}");
    }
}

#[test]
fn while_nothing_is_sent_there_is_a_least_rate_and_no_more() {
    let mut budget = RepairBudget::new(0, 0);
    all(&mut budget, 0, sent(0, 0), false);
    let repaired: u64 = (1..=1_000).map(|i| all(&mut budget, i * 10 * MS, sent(0, 0), false)).sum();
    assert!((2_400_000..2_700_000).contains(&repaired), "{repaired} in 10 s");
    // A long silence earns no burst, and neither does what was sent meanwhile.
    let repaired = all(&mut budget, 1_000 * SECOND, sent(1 << 40, 400_000), false);
    assert!((100_000..100_000 + 2 * LEAST as u64).contains(&repaired), "{repaired}");
    let repaired = all(&mut budget, 1_001 * SECOND, sent(1 << 41, 1 << 40), false);
    assert!(repaired <= MOST as u64 + FRAME, "{repaired}");
}
