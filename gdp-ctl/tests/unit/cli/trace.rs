//! Unit tests of `cli::trace`.

use super::*;
use serde_json::{Value, json};

#[test]
fn a_path_is_told_hop_by_hop() {
    let name = |i: u8| Name::from_bytes([i; 32]);
    let beyond = json!([{"domain": name(8), "switch": name(9)}]);
    let domain = |depth, outcome, inside| {
        let reason = "it says so";
        json!({
            "depth": depth, "domain": name(8), "switch": name(9), "rtt_us": if depth == 1 { Some(300) } else { None },
            "outcome": outcome, "reason": reason, "inside": inside,
        })
    };
    let hops = json!([{"hop": 1, "switch": name(5), "rtt_us": 700}, {"hop": 2, "switch": null, "rtt_us": null}]);
    let domains = json!([
        domain(1, "traced", json!({"links": 0, "rtt_us": 500, "hops": null})),
        domain(2, "traced", json!({"links": 2, "rtt_us": null, "hops": hops})),
        domain(3, "unanswered", Value::Null),
        domain(3, "refused", Value::Null),
        domain(3, "loop", Value::Null),
        domain(3, "too_far", Value::Null),
    ]);
    let hop = |hop, switch, rtt_us, end| TraceHop { hop, switch, rtt_us, end };
    let end = serde_json::from_value(json!({"links": 1, "beyond": beyond})).unwrap();
    let hops =
        vec![hop(0, Some(name(1)), Some(0), None), hop(1, None, None, None), hop(2, Some(name(3)), Some(1234), end)];
    let domains = serde_json::from_value(domains).unwrap();
    let paths = vec![TracePath { egress: name(3), reached: true, hops, domains }];
    let lines = describe(&TraceOutput { name: name(7), paths });
    let lines: Vec<_> = lines.iter().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
    assert_eq!(lines[1], format!("0 {:#} this switch", name(1)));
    assert_eq!(lines[2], "1 * no answer");
    assert_eq!(
        lines[3],
        format!("2 {:#} 1.234 ms → 1 local link, domain {:#} by its switch {:#}", name(3), name(8), name(9))
    );
    let entered = |time| format!("domain {:#} by its switch {:#} {time}", name(8), name(9));
    let masked = format!("… inside of domain {:#} (masked) 0.500 ms → 0 local links", name(8));
    assert_eq!(lines[4..6], [entered("0.300 ms"), masked]);
    let no_echo = entered("no answer to echoes");
    let open = format!("inside of domain {:#} no answer from all of it → 2 local links", name(8));
    assert_eq!(lines[6..10], [&no_echo, &format!("1 {:#} 0.700 ms", name(5)), "2 * no answer", &open]);
    let why_not: Vec<_> = lines[10..].iter().filter(|line| **line != no_echo).collect();
    assert_eq!(
        why_not,
        [
            "its border does not say what is behind it: no answer in time",
            "not traced: it says so",
            "not traced: the name has crossed this domain before",
            "not traced: the name has crossed 16 domains already",
        ]
    );
}
