// Draws the topology: places switches by stress majorization, so that a chain is a line and a ring
// a ring. The same topology always looks the same.
"use strict";

const SVG = "http://www.w3.org/2000/svg";
const MAP_WIDTH = 620;
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
    let at = nodes.map((_, i) => [Math.cos((2 * Math.PI * i) / count), Math.sin((2 * Math.PI * i) / count)]);
    for (let round = 0; round < 250; round++) {
      at = at.map(([x, y], i) => {
        let [sumX, sumY, sum] = [0, 0, 0];
        for (let j = 0; j < count; j++) {
          if (i === j) continue;
          const want = Math.max(far[i][j], far[j][i]);
          const [dx, dy] = [x - at[j][0], y - at[j][1]];
          const length = Math.hypot(dx, dy) || 1e-6;
          const weight = 1 / (want * want);
          sumX += weight * (at[j][0] + (want * dx) / length);
          sumY += weight * (at[j][1] + (want * dy) / length);
          sum += weight;
        }
        return sum ? [sumX / sum, sumY / sum] : [x, y];
      });
    }
    return turn(at);
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
  function fit(at) {
    const spread = (axis) => Math.max(...at.map((p) => Math.abs(p[axis]))) || 0;
    const [wide, high] = [spread(0), spread(1)];
    const scale = Math.min(120, (MAP_WIDTH / 2 - 64) / (wide || 1), 190 / (high || 1));
    const height = Math.max(112, 2 * high * scale + 96);
    return [at.map(([x, y]) => [MAP_WIDTH / 2 + x * scale, height / 2 - 6 + y * scale]), height];
  }

  function draw(nodes, edges, rates) {
    const picture = document.getElementById("map");
    picture.replaceChildren();
    if (!nodes.length) {
      picture.setAttribute("viewBox", `0 0 ${MAP_WIDTH} 60`);
      picture.append(svg("text", { x: MAP_WIDTH / 2, y: 34, class: "sub" }, "No switch is known"));
      return;
    }
    // The order of names, so that a switch that fails does not move the others.
    const sorted = [...nodes].sort((a, b) => (a.switch.name < b.switch.name ? -1 : 1));
    const [at, height] = fit(place(sorted, edges));
    const where = new Map(sorted.map((node, i) => [node.switch.name, at[i]]));
    const foreign = new Set(nodes.filter((node) => node.domain).map((node) => node.switch.name));
    const own = nodes.find((node) => node.own)?.switch.name;
    const crowded = nodes.length > CROWDED;
    picture.setAttribute("viewBox", `0 0 ${MAP_WIDTH} ${height}`);
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
      const key = JSON.stringify([nodes, edges, path]);
      if (key !== drawn) {
        drawn = key;
        draw(nodes, edges, rates);
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
