// Draws the topology: places switches by stress majorization, so that a chain is a line and a ring
// a ring. The same topology always looks the same.
"use strict";

const SVG = "http://www.w3.org/2000/svg";
// The drawing is as wide as its panel, within these bounds, so that its texts keep their size.
const MAP_WIDTHS = [320, 640];
// From this number of switches on, only names are written.
const CROWDED = 24;

const map = (() => {
  let drawn = "";
  let path = [];
  let last = null;

  function svg(name, attributes, text) {
    const element = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    return element;
  }

  // Returns the number of hops between all nodes.
  function distances(count, near) {
    return Array.from({ length: count }, (_, from) => {
      const hops = new Array(count).fill(Infinity);
      hops[from] = 0;
      const queue = [from];
      for (const at of queue) {
        for (const next of near[at]) {
          if (hops[next] === Infinity) {
            hops[next] = hops[at] + 1;
            queue.push(next);
          }
        }
      }
      const farthest = Math.max(...hops.filter(Number.isFinite));
      return hops.map((hop) => (Number.isFinite(hop) ? hop : farthest + 1.2));
    });
  }

  function place(nodes, edges) {
    const count = nodes.length;
    const index = new Map(nodes.map((node, i) => [node.switch.name, i]));
    const near = nodes.map(() => []);
    for (const { ends: [a, b] } of edges) {
      near[index.get(a)].push(index.get(b));
      near[index.get(b)].push(index.get(a));
    }
    const far = distances(count, near);
    // Majorization finds the nearest minimum, so it begins several times, each time with the nodes
    // on a circle in another order. The first order is that of a walk through the graph.
    const orders = [walk(near), nodes.map((_, i) => i)];
    for (let step = 2; step < 10; step++) orders.push(orders[step % 2].map((_, i, of) => of[(i * step) % count]));
    const isWhole = (order) => new Set(order).size === count;
    const placed = orders.filter(isWhole).map((order) => majorize(order, far));
    const best = placed.reduce((one, other) => (other.stress < one.stress * 0.999 ? other : one));
    return turn(best.at);
  }

  // Returns all nodes, neighbours after one another.
  function walk(near) {
    const [order, seen] = [[], new Set()];
    const visit = (node) => {
      if (seen.has(node)) return;
      seen.add(node);
      order.push(node);
      near[node].forEach(visit);
    };
    near.forEach((_, node) => visit(node));
    return order;
  }

  // Moves the nodes to where their distances are nearest to their numbers of hops.
  function majorize(order, far) {
    const count = order.length;
    const at = new Array(count);
    order.forEach((node, i) => {
      const angle = (2 * Math.PI * i) / count;
      at[node] = [Math.cos(angle) * count / 6, Math.sin(angle) * count / 6];
    });
    const want = (i, j) => Math.max(far[i][j], far[j][i]);
    for (let round = 0; round < 150; round++) {
      for (let i = 0; i < count; i++) {
        let [sumX, sumY, sum] = [0, 0, 0];
        for (let j = 0; j < count; j++) {
          if (i === j) continue;
          const [dx, dy] = [at[i][0] - at[j][0], at[i][1] - at[j][1]];
          const length = Math.hypot(dx, dy) || 1e-6;
          const weight = 1 / want(i, j) ** 2;
          sumX += weight * (at[j][0] + (want(i, j) * dx) / length);
          sumY += weight * (at[j][1] + (want(i, j) * dy) / length);
          sum += weight;
        }
        if (sum) at[i] = [sumX / sum, sumY / sum];
      }
    }
    let stress = 0;
    for (let i = 0; i < count; i++) {
      for (let j = 0; j < i; j++) {
        const length = Math.hypot(at[i][0] - at[j][0], at[i][1] - at[j][1]);
        stress += ((length - want(i, j)) / want(i, j)) ** 2;
      }
    }
    return { at, stress };
  }

  // Turns the longest axis to the horizontal.
  function turn(at) {
    const mean = [0, 1].map((axis) => at.reduce((sum, point) => sum + point[axis], 0) / at.length);
    let [xx, xy, yy] = [0, 0, 0];
    for (const [x, y] of at) {
      xx += (x - mean[0]) ** 2;
      xy += (x - mean[0]) * (y - mean[1]);
      yy += (y - mean[1]) ** 2;
    }
    const angle = -Math.atan2(2 * xy, xx - yy) / 2;
    const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
    return at.map(([x, y]) => [
      (x - mean[0]) * cos - (y - mean[1]) * sin,
      (x - mean[0]) * sin + (y - mean[1]) * cos,
    ]);
  }

  // Fits the points into the drawing. Returns them with its height.
  function fit(at, width) {
    const spread = (axis) => Math.max(...at.map((p) => Math.abs(p[axis]))) || 0;
    const [wide, high] = [spread(0), spread(1)];
    const scale = Math.min(170, (width / 2 - 70) / (wide || 1), 200 / (high || 1));
    const height = Math.max(112, 2 * high * scale + 96);
    return [at.map(([x, y]) => [width / 2 + x * scale, height / 2 - 6 + y * scale]), height];
  }

  function widthNow() {
    const { clientWidth } = document.querySelector("#topology figure");
    return Math.min(MAP_WIDTHS[1], Math.max(MAP_WIDTHS[0], clientWidth));
  }

  function draw(nodes, edges, rates, width) {
    const picture = document.getElementById("map");
    picture.replaceChildren();
    if (!nodes.length) {
      picture.setAttribute("viewBox", `0 0 ${width} 60`);
      picture.append(svg("text", { x: width / 2, y: 34, class: "sub" }, "No switch is known"));
      return;
    }
    // The order of names, so that a switch that fails does not move the others.
    const sorted = [...nodes].sort((a, b) => (a.switch.name < b.switch.name ? -1 : 1));
    const [at, height] = fit(place(sorted, edges), width);
    const where = new Map(sorted.map((node, i) => [node.switch.name, at[i]]));
    const foreign = new Set(nodes.filter((node) => node.domain).map((node) => node.switch.name));
    const own = nodes.find((node) => node.own)?.switch.name;
    const crowded = nodes.length > CROWDED;
    picture.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const onPath = new Set(path.flatMap((hops) => hops.slice(1).map((hop, i) => [hops[i], hop].sort().join())));
    for (const { ends, cost, state } of edges) {
      const [[x1, y1], [x2, y2]] = ends.map((end) => where.get(end));
      const kind = foreign.has(ends[0]) || foreign.has(ends[1]) ? " border" : "";
      const marked = onPath.has([...ends].sort().join()) ? " onpath" : "";
      picture.append(svg("line", { x1, y1, x2, y2, class: `edge ${state}${kind}${marked}` }));
      if (crowded) continue;
      const words = state === "up" ? `cost ${cost}` : state === "half" ? "half down" : "daemon silent";
      const [x, y] = [(x1 + x2) / 2, (y1 + y2) / 2];
      picture.append(svg("text", { x, y: y - 5, class: state === "half" ? "sub lost-text" : "sub" }, words));
      if (own && ends.includes(own)) {
        const peer = ends.find((end) => end !== own);
        const rate = svg("text", { x, y: y + 13, class: "sub", "data-peer": peer }, rates.get(peer) ?? "");
        picture.append(rate);
      }
    }
    sorted.forEach((node, i) => picture.append(...mark(node, at[i], crowded)));
  }

  function mark(node, [x, y], crowded) {
    const kind = ["node", node.own && "own", node.domain && "foreign", !node.reached && "lost"];
    const of = kind.filter(Boolean).join(" ");
    const shape = node.domain
      ? svg("rect", { x: x - 8, y: y - 8, width: 16, height: 16, class: of })
      : svg("circle", { cx: x, cy: y, r: crowded ? 6 : 9, class: of });
    shape.append(svg("title", {}, `${node.switch.label ?? ""} ${node.switch.name}`.trim()));
    const title = svg("text", { x, y: y + (crowded ? 17 : 23) }, node.switch.label ?? node.switch.short);
    const words = [];
    if (node.own) words.push("this switch");
    if (node.rib) words.push("RIB");
    if (node.domain) words.push(`domain ${node.domain.label ?? node.domain.short}`);
    if (node.attached) words.push(`${node.attached} attached`);
    if (!node.reached) words.push("NO PATH");
    const below = svg("text", { x, y: y + 36, class: node.reached ? "sub" : "sub lost-text" }, words.join(" · "));
    return crowded && node.reached ? [shape, title] : [shape, title, below];
  }

  return {
    // Draws the map if it has changed, and writes the rates on the links of this switch.
    show(nodes, edges, rates) {
      last = [nodes, edges];
      const width = widthNow();
      const key = JSON.stringify([nodes, edges, path, width]);
      if (key !== drawn) {
        drawn = key;
        draw(nodes, edges, rates, width);
      }
      for (const label of document.querySelectorAll("#map [data-peer]")) {
        label.textContent = rates.get(label.dataset.peer) ?? "";
      }
    },
    // Marks the links of these paths, each a list of switches.
    mark(paths) {
      path = paths;
      if (last) this.show(...last, new Map());
    },
  };
})();
