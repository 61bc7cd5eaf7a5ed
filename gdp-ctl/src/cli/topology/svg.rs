//! The topology as a picture: domains as frames, switches as boxes, links as lines with their costs.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde_json::Value;

use super::super::output::short;
use super::layout::{Rect, on_line, place};
use super::{Link, links, switches, text};

/// Of a character of the labels' font, and of a line of them, in pixels.
const CHARACTER: f64 = 7.3;
const LINE: f64 = 16.0;

/// Around what a frame holds; its title is in it.
const MARGIN: f64 = 34.0;

/// Between frames.
const APART: f64 = 90.0;

/// Names that are listed at one switch.
const MOST_NAMES: usize = 8;

const STYLE: &str = "text{font:12px monospace;fill:#1c2733;text-anchor:middle}.title{font-weight:bold;text-anchor:start}\
    .frame{fill:#f4f7fa;stroke:#8a99a8;stroke-dasharray:6 4}.abroad{fill:#fbf6ee}.switch{fill:#fff;stroke:#33526e;stroke-width:1.5}\
    .own{fill:#e3effa;stroke-width:3}.rib{stroke:#a0522d}.link{stroke:#5b6b7a;stroke-width:1.5}.half{stroke-dasharray:4 4}\
    .border{stroke:#a0522d}.cost{fill:#fff;fill-opacity:.9}.small{font-size:11px;fill:#46586a}";

/// A switch in the picture.
struct Node {
    class: &'static str,
    lines: Vec<String>,
}

/// Switches of another domain that links lead to.
#[derive(Default)]
struct Abroad {
    /// Indices of nodes.
    nodes: Vec<usize>,
}

/// `names`: what there is at each switch, a line each.
pub fn svg(reply: &Value, names: &BTreeMap<String, Vec<String>>) -> String {
    let (mut nodes, mut index, mut abroad) = (Vec::new(), BTreeMap::new(), BTreeMap::<String, Abroad>::new());
    for switch in switches(reply) {
        index.insert(text(&switch["switch"]), nodes.len());
        nodes.push(node(switch, reply, names));
    }
    let links = links(reply);
    let at_home = nodes.len();
    let mut lines = Vec::new();
    for Link { ends: [a, b], cost, by_both, domain } in links {
        let mut end = |name: &String| {
            *index.entry(name.clone()).or_insert_with(|| {
                nodes.push(Node { class: "switch", lines: vec![short(&Value::from(name.as_str()))] });
                nodes.len() - 1
            })
        };
        let (from, to) = (end(&a), end(&b));
        if let Some(domain) = &domain {
            let known = &mut abroad.entry(domain.clone()).or_default().nodes;
            if !known.contains(&to) {
                known.push(to);
            }
        }
        let class = match (domain.is_some(), by_both) {
            (true, _) => "link border",
            (false, true) => "link",
            (false, false) => "link half",
        };
        lines.push((from, to, cost, class));
    }
    let mut boxes: Vec<Rect> = nodes.iter().map(Node::size).collect();
    let is_abroad = |node: usize| node >= at_home && abroad.values().any(|a| a.nodes.contains(&node));
    let home: Vec<usize> = (0..nodes.len()).filter(|node| !is_abroad(*node)).collect();
    place_home(&home, &lines, &mut boxes);
    let own_frame = Rect::around(&home.iter().map(|i| boxes[*i]).collect::<Vec<_>>()).unwrap_or_default().grown(MARGIN);
    let frames = place_abroad(own_frame, &abroad, &lines, &mut boxes);

    let mut out = String::new();
    let own_title = match reply["domain"].as_str() {
        Some(_) => format!("domain {}", short(&reply["domain"])),
        None => "no domain".into(),
    };
    frame(&mut out, own_frame, "frame", &own_title);
    for (domain, rect) in &frames {
        frame(&mut out, *rect, "frame abroad", &format!("domain {}", short(&Value::from(domain.as_str()))));
    }
    draw_lines(&mut out, &lines, &boxes);
    nodes.iter().zip(&boxes).for_each(|(node, rect)| node.draw(&mut out, rect));
    let all: Vec<Rect> = frames.into_iter().map(|(_, rect)| rect).chain([own_frame]).collect();
    document(&out, Rect::around(&all).unwrap_or_default().grown(20.0))
}

fn node(switch: &Value, reply: &Value, names: &BTreeMap<String, Vec<String>>) -> Node {
    let (is_own, is_rib) = (switch["switch"] == reply["own"], switch["rib"] == true);
    let class = match (is_own, is_rib) {
        (false, false) => "switch",
        (true, false) => "switch own",
        (false, true) => "switch rib",
        (true, true) => "switch own rib",
    };
    let bit = switch["bit"].as_u64().map_or_else(|| "no bit".to_owned(), |bit| format!("bit {bit}"));
    let mut lines = vec![short(&switch["switch"]), if is_rib { format!("{bit} · RIB") } else { bit }];
    let there = names.get(&text(&switch["switch"])).map_or(&[][..], Vec::as_slice);
    lines.extend(there.iter().take(MOST_NAMES).cloned());
    if there.len() > MOST_NAMES {
        lines.push(format!("… and {} more", there.len() - MOST_NAMES));
    }
    Node { class, lines }
}

impl Node {
    fn size(&self) -> Rect {
        let longest = self.lines.iter().map(|line| line.chars().count()).max().unwrap_or_default();
        let (width, height) = (longest as f64 * CHARACTER + 18.0, self.lines.len() as f64 * LINE + 12.0);
        Rect { width, height, ..Rect::default() }
    }

    fn draw(&self, out: &mut String, rect: &Rect) {
        rectangle(out, *rect, self.class, 7);
        for (i, line) in self.lines.iter().enumerate() {
            let y = rect.y - rect.height / 2.0 + 6.0 + LINE * (i as f64 + 0.75);
            let class = if i == 0 { "" } else { " class=\"small\"" };
            let _ = writeln!(out, "<text x=\"{:.1}\" y=\"{y:.1}\"{class}>{}</text>", rect.x, escaped(line));
        }
    }
}

/// A line of the picture: nodes, cost and class.
type Line = (usize, usize, u64, &'static str);

fn place_home(home: &[usize], lines: &[Line], boxes: &mut [Rect]) {
    let of = |node: usize| home.iter().position(|at| *at == node);
    let edges: Vec<_> = lines.iter().filter_map(|(a, b, ..)| Some((of(*a)?, of(*b)?))).collect();
    let mut placed: Vec<Rect> = home.iter().map(|i| boxes[*i]).collect();
    place(&mut placed, &edges);
    home.iter().zip(placed).for_each(|(i, rect)| boxes[*i] = rect);
}

/// Puts the other domains beside the own one, each on the side and at the height of where its links come from. Returns their frames.
fn place_abroad(
    own: Rect,
    abroad: &BTreeMap<String, Abroad>,
    lines: &[Line],
    boxes: &mut [Rect],
) -> Vec<(String, Rect)> {
    let near = |domain: &Abroad, boxes: &[Rect]| {
        let ends = lines.iter().filter(|(_, to, ..)| domain.nodes.contains(to)).map(|(from, ..)| boxes[*from]);
        let (x, y, count) = ends.fold((0.0, 0.0, 0.0), |(x, y, n), end| (x + end.x, y + end.y, n + 1.0));
        (x / f64::max(count, 1.0), y / f64::max(count, 1.0))
    };
    let mut by_height: Vec<_> = abroad.iter().map(|(name, domain)| (near(domain, boxes), name, domain)).collect();
    by_height.sort_by(|a, b| a.0.1.total_cmp(&b.0.1));
    let mut lowest = [f64::NEG_INFINITY; 2];
    let mut frames = Vec::new();
    for ((x, y), name, domain) in by_height {
        let is_right = x >= own.x;
        let title = (name.chars().count().min(16) as f64 + 4.0) * CHARACTER;
        let width = domain.nodes.iter().map(|i| boxes[*i].width).fold(title, f64::max);
        let height: f64 = domain.nodes.iter().map(|i| boxes[*i].height + 22.0).sum::<f64>() - 22.0;
        let mut rect = Rect { x: 0.0, y, width, height }.grown(MARGIN);
        let away = own.width / 2.0 + APART + rect.width / 2.0;
        rect.x = if is_right { own.x + away } else { own.x - away };
        rect.y = rect.y.max(lowest[usize::from(is_right)] + 30.0 + rect.height / 2.0);
        lowest[usize::from(is_right)] = rect.y + rect.height / 2.0;
        let mut top = rect.y - height / 2.0;
        for i in &domain.nodes {
            (boxes[*i].x, boxes[*i].y) = (rect.x, top + boxes[*i].height / 2.0);
            top += boxes[*i].height + 22.0;
        }
        frames.push((name.clone(), rect));
    }
    frames
}

fn draw_lines(out: &mut String, lines: &[Line], boxes: &[Rect]) {
    for (a, b, _, class) in lines {
        let ([x1, y1], [x2, y2]) = ([boxes[*a].x, boxes[*a].y], [boxes[*b].x, boxes[*b].y]);
        let _ = writeln!(out, "<line class=\"{class}\" x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\"/>");
    }
    let mut taken = boxes.to_vec();
    for (a, b, cost, _) in lines {
        let cost = cost.to_string();
        let size = (cost.len() as f64 * CHARACTER + 6.0, LINE);
        let label = on_line(&boxes[*a], &boxes[*b], size, &taken);
        taken.push(label);
        rectangle(out, label, "cost", 3);
        let _ = writeln!(out, "<text x=\"{:.1}\" y=\"{:.1}\" class=\"small\">{cost}</text>", label.x, label.y + 4.0);
    }
}

fn frame(out: &mut String, rect: Rect, class: &str, title: &str) {
    rectangle(out, rect, class, 12);
    let (x, y) = (rect.x - rect.width / 2.0 + 12.0, rect.y - rect.height / 2.0 + 20.0);
    let _ = writeln!(out, "<text class=\"title\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>", escaped(title));
}

fn rectangle(out: &mut String, rect: Rect, class: &str, radius: u32) {
    let (x, y) = (rect.x - rect.width / 2.0, rect.y - rect.height / 2.0);
    let _ = writeln!(
        out,
        "<rect class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" rx=\"{radius}\"/>",
        rect.width, rect.height
    );
}

fn document(body: &str, view: Rect) -> String {
    let (x, y) = (view.x - view.width / 2.0, view.y - view.height / 2.0);
    let (width, height) = (view.width, view.height);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
         viewBox=\"{x:.1} {y:.1} {width:.1} {height:.1}\">\n<style>{STYLE}</style>\n\
         <rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"#fff\"/>\n{body}</svg>"
    )
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

#[cfg(test)]
#[path = "../../../tests/unit/cli/topology/svg.rs"]
mod tests;
