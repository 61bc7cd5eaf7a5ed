//! Where the boxes and lines of a picture go: boxes by stress majorisation (Gansner, Koren and North, 2004) of the distances in the
//! graph, then apart until none covers another or a line. The same graph, the same picture. Pure: sizes and edges in, places out.

/// Sweeps of the majorisation.
const SWEEPS: usize = 300;

/// Rounds in which boxes move apart.
const ROUNDS: usize = 400;

/// Between neighbours, in pixels, if nothing is in the way.
const STEP: f64 = 170.0;

/// Between boxes, and between a box and a line that is not its own.
const GAP: f64 = 44.0;

/// A box, by its middle and its size.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rect {
    pub x: f64,
    pub y: f64,
    pub width: f64,
    pub height: f64,
}

impl Rect {
    /// How far two boxes reach into each other, or miss each other by less than `gap`, in each direction; 0 if they do not.
    fn overlap(&self, other: &Self, gap: f64) -> (f64, f64) {
        let by = |distance: f64, sizes: f64| (sizes / 2.0 + gap - distance.abs()).max(0.0);
        (by(self.x - other.x, self.width + other.width), by(self.y - other.y, self.height + other.height))
    }

    pub fn covers(&self, other: &Self, gap: f64) -> bool {
        let (x, y) = self.overlap(other, gap);
        x > 0.0 && y > 0.0
    }

    /// The smallest one that holds all.
    pub fn around(all: &[Self]) -> Option<Self> {
        let edge = |low: &dyn Fn(&Self) -> f64| all.iter().map(low).reduce(f64::min);
        let left = edge(&|r| r.x - r.width / 2.0)?;
        let top = edge(&|r| r.y - r.height / 2.0)?;
        let right = -edge(&|r| -r.x - r.width / 2.0)?;
        let bottom = -edge(&|r| -r.y - r.height / 2.0)?;
        Some(Self { x: (left + right) / 2.0, y: (top + bottom) / 2.0, width: right - left, height: bottom - top })
    }

    pub fn grown(self, by: f64) -> Self {
        Self { width: self.width + 2.0 * by, height: self.height + 2.0 * by, ..self }
    }
}

/// Gives boxes of these sizes their places.
pub fn place(boxes: &mut [Rect], edges: &[(usize, usize)]) {
    let distances = distances(boxes.len(), edges);
    let mut at = circle(boxes.len(), edges);
    for _ in 0..SWEEPS {
        majorise(&mut at, &distances);
    }
    for (rect, (x, y)) in boxes.iter_mut().zip(at) {
        (rect.x, rect.y) = (x * STEP, y * STEP);
    }
    for _ in 0..ROUNDS {
        if !move_apart(boxes, edges) {
            break;
        }
    }
}

/// Where the label of a line goes: on the line, as near to its middle as it covers nothing of `taken`.
pub fn on_line(from: &Rect, to: &Rect, (width, height): (f64, f64), taken: &[Rect]) -> Rect {
    let at = |part: f64| Rect { x: from.x + (to.x - from.x) * part, y: from.y + (to.y - from.y) * part, width, height };
    let parts = (0..=16).flat_map(|i| [0.5 - f64::from(i) * 0.025, 0.5 + f64::from(i) * 0.025]);
    let mut places = parts.map(at);
    places.find(|label| taken.iter().all(|other| !other.covers(label, 1.0))).unwrap_or_else(|| at(0.5))
}

/// Hops between any two; between parts without a connection, a little more than any path has.
fn distances(count: usize, edges: &[(usize, usize)]) -> Vec<Vec<f64>> {
    let near = near(count, edges);
    let apart = (count as f64).sqrt() + 1.0;
    let from = |start: usize| {
        let mut hops = vec![apart; count];
        let mut queue = std::collections::VecDeque::from([(start, 0.0)]);
        let mut seen = vec![false; count];
        seen[start] = true;
        while let Some((at, distance)) = queue.pop_front() {
            hops[at] = distance;
            for next in &near[at] {
                if !std::mem::replace(&mut seen[*next], true) {
                    queue.push_back((*next, distance + 1.0));
                }
            }
        }
        hops
    };
    (0..count).map(from).collect()
}

/// Around a circle, in the order of a walk into the depth: so a ring begins as one.
fn circle(count: usize, edges: &[(usize, usize)]) -> Vec<(f64, f64)> {
    let near = near(count, edges);
    let (mut order, mut seen) = (Vec::new(), vec![false; count]);
    for start in 0..count {
        let mut stack = vec![start];
        while let Some(at) = stack.pop() {
            if !std::mem::replace(&mut seen[at], true) {
                order.push(at);
                stack.extend(near[at].iter().rev());
            }
        }
    }
    let mut at = vec![(0.0, 0.0); count];
    for (place, node) in order.into_iter().enumerate() {
        let (sin, cos) = (std::f64::consts::TAU * place as f64 / count as f64).sin_cos();
        let radius = count as f64 / std::f64::consts::TAU;
        at[node] = (radius * sin, -radius * cos);
    }
    at
}

fn near(count: usize, edges: &[(usize, usize)]) -> Vec<Vec<usize>> {
    let mut near = vec![Vec::new(); count];
    for (a, b) in edges {
        near[*a].push(*b);
        near[*b].push(*a);
    }
    near
}

/// Moves each node to where the others, each at its distance, would have it.
fn majorise(at: &mut [(f64, f64)], distances: &[Vec<f64>]) {
    for i in 0..at.len() {
        let (mut x, mut y, mut weights) = (0.0, 0.0, 0.0);
        for j in (0..at.len()).filter(|j| *j != i) {
            let wanted = distances[i][j];
            let (dx, dy) = (at[i].0 - at[j].0, at[i].1 - at[j].1);
            let stretch = wanted / dx.hypot(dy).max(1e-6);
            let weight = 1.0 / (wanted * wanted);
            x += weight * (at[j].0 + dx * stretch);
            y += weight * (at[j].1 + dy * stretch);
            weights += weight;
        }
        if weights > 0.0 {
            at[i] = (x / weights, y / weights);
        }
    }
}

/// Moves boxes away from each other and from lines that are not theirs; whether any had to.
fn move_apart(boxes: &mut [Rect], edges: &[(usize, usize)]) -> bool {
    let mut moved = false;
    for i in 0..boxes.len() {
        for j in i + 1..boxes.len() {
            let (x, y) = boxes[i].overlap(&boxes[j], GAP);
            if x <= 0.0 || y <= 0.0 {
                continue;
            }
            moved = true;
            // Along the shorter way out; of two at the same place the first goes first.
            let half = |by: f64, distance: f64| if distance > 0.0 { by / 2.0 } else { -by / 2.0 };
            let (dx, dy) =
                if x < y { (half(x, boxes[i].x - boxes[j].x), 0.0) } else { (0.0, half(y, boxes[i].y - boxes[j].y)) };
            (boxes[i].x, boxes[i].y) = (boxes[i].x + dx, boxes[i].y + dy);
            (boxes[j].x, boxes[j].y) = (boxes[j].x - dx, boxes[j].y - dy);
        }
        for (a, b) in edges.iter().filter(|(a, b)| *a != i && *b != i) {
            if let Some((dx, dy)) = off_line(&boxes[i], &boxes[*a], &boxes[*b]) {
                moved = true;
                (boxes[i].x, boxes[i].y) = (boxes[i].x + dx, boxes[i].y + dy);
            }
        }
    }
    moved
}

/// A step that takes a box away from a line that crosses it, or nearly.
fn off_line(rect: &Rect, from: &Rect, to: &Rect) -> Option<(f64, f64)> {
    let (dx, dy) = (to.x - from.x, to.y - from.y);
    let length = dx.hypot(dy).max(1e-6);
    let part = ((rect.x - from.x) * dx + (rect.y - from.y) * dy) / (length * length);
    if !(0.0..=1.0).contains(&part) {
        return None;
    }
    let (across_x, across_y) = (-dy / length, dx / length);
    let distance = (rect.x - from.x) * across_x + (rect.y - from.y) * across_y;
    let reach = (rect.width * across_x.abs() + rect.height * across_y.abs()) / 2.0 + GAP / 5.0;
    let missing = reach - distance.abs();
    let side = if distance < 0.0 { -1.0 } else { 1.0 };
    (missing > 0.0).then_some((across_x * side * missing * 0.6, across_y * side * missing * 0.6))
}

#[cfg(test)]
#[path = "../../../tests/unit/cli/topology/layout.rs"]
mod tests;
