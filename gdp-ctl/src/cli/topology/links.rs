//! The links of a topology reply, without duplicates.

use std::collections::BTreeMap;

use gdp_proto::admin::topology::TopologyReply;
use gdp_wire::Name;

/// A link between two switches, at least one of them in the own domain.
pub struct Edge {
    /// The second switch belongs to `domain`, if that is set.
    pub ends: [Name; 2],
    pub cost: u32,
    /// Whether both ends state the link; only then it carries frames. For a link into another
    /// domain, the other end's statement is not known.
    pub by_both: bool,
    pub domain: Option<Name>,
}

/// Returns each adjacency once, with the larger of the costs.
pub fn edges(reply: &TopologyReply) -> Vec<Edge> {
    let (mut home, mut others) = (BTreeMap::<[Name; 2], Edge>::new(), Vec::new());
    for switch in &reply.switches {
        for neighbour in &switch.neighbours {
            let (mut ends, cost) = ([switch.switch, neighbour.switch], neighbour.cost);
            ends.sort();
            match home.get_mut(&ends) {
                Some(known) => (known.cost, known.by_both) = (known.cost.max(cost), true),
                None => drop(home.insert(ends, Edge { ends, cost, by_both: false, domain: None })),
            }
        }
        others.extend(switch.borders.iter().map(|border| Edge {
            ends: [switch.switch, border.switch],
            cost: border.cost,
            by_both: true,
            domain: Some(border.domain),
        }));
    }
    home.into_values().chain(others).collect()
}
