//! The links of a topology reply, each once.

use std::collections::BTreeMap;

use serde_json::Value;

/// A link between two switches, of whom one at least is of the own domain.
pub struct Link {
    /// Names; the second one is of `domain`, if that is another.
    pub ends: [String; 2],
    pub cost: u64,
    /// Only then frames go by it. Of a link into another domain, the other end is not heard.
    pub by_both: bool,
    pub domain: Option<String>,
}

/// Each adjacency once, with the larger of the costs.
pub fn links(reply: &Value) -> Vec<Link> {
    let (mut home, mut abroad) = (BTreeMap::<[String; 2], Link>::new(), Vec::new());
    for switch in switches(reply) {
        let own = text(&switch["switch"]);
        for neighbour in near(switch) {
            let (other, cost) = (text(&neighbour["switch"]), neighbour["cost"].as_u64().unwrap_or_default());
            let mut ends = [own.clone(), other];
            ends.sort();
            match home.get_mut(&ends) {
                Some(known) => (known.cost, known.by_both) = (known.cost.max(cost), true),
                None => drop(home.insert(ends.clone(), Link { ends, cost, by_both: false, domain: None })),
            }
        }
        for border in switch["borders"].as_array().into_iter().flatten() {
            let (ends, cost) = ([own.clone(), text(&border["switch"])], border["cost"].as_u64().unwrap_or_default());
            abroad.push(Link { ends, cost, by_both: true, domain: Some(text(&border["domain"])) });
        }
    }
    home.into_values().chain(abroad).collect()
}

pub fn switches(reply: &Value) -> impl Iterator<Item = &Value> {
    reply["switches"].as_array().into_iter().flatten()
}

pub fn near(switch: &Value) -> impl Iterator<Item = &Value> {
    switch["neighbours"].as_array().into_iter().flatten()
}

pub fn text(name: &Value) -> String {
    name.as_str().unwrap_or_default().to_owned()
}
