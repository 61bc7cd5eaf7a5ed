// Asks for a snapshot every second, and shows it. Rates are differences between snapshots.
"use strict";

const PERIOD_MS = 1000;
const HISTORY = 120;
// Rates are means over so many seconds.
const WINDOW_MS = 3000;

const WORKING = { up: "ok-text", online: "ok-text", joined: "ok-text" };
const WAITING = { grace: "warn-text", waiting: "warn-text", pending: "warn-text", invited: "muted", left: "muted" };

function stateCell(state) {
  const className = WORKING[state] ?? WAITING[state] ?? "bad-text";
  return { text: state, className };
}

function rowClass(state) {
  const className = stateCell(state).className;
  return className === "bad-text" ? "bad" : className === "warn-text" ? "warn" : "";
}

// Counts of earlier snapshots, for rates.
const past = [];

function remember(snapshot) {
  const counts = new Map();
  for (const [counter, count] of Object.entries(snapshot.counters)) counts.set(`counter ${counter}`, count);
  for (const link of snapshot.links.rows) {
    const key = `${link.peer.name} ${link.via} ${link.address}`;
    for (const count of ["sent", "arrived", "dropped"]) counts.set(`${count} ${key}`, link[count]);
  }
  for (const { name, frames } of snapshot.names.rows) if (frames !== null) counts.set(`name ${name.name}`, frames);
  past.push([snapshot.uptime_ms, counts]);
  while (past.length > 2 && past[1][0] <= snapshot.uptime_ms - WINDOW_MS) past.shift();
}

// Returns a rate per second; undefined if it is not known yet.
function rate(key) {
  const [latest, first] = [past[past.length - 1], past.find(([, counts]) => counts.has(key))];
  if (!latest || latest === first || !first || !latest[1].has(key)) return undefined;
  // A counter that has fallen began anew.
  return Math.max(0, ((latest[1].get(key) - first[1].get(key)) * 1000) / (latest[0] - first[0]));
}

function linkRate(link, count) {
  return rate(`${count} ${link.peer.name} ${link.via} ${link.address}`);
}

let now = 0;
const tables = {
  robots: new Table("robots", [
    { title: "robot", cell: (row) => ({ text: row.label, small: row.entity?.short }) },
    { title: "state", cell: (row) => stateCell(row.state) },
    { title: "exposes", kind: "text", cell: (row) => row.expose || "–" },
    { title: "imports", kind: "text", cell: (row) => row.import || "–" },
    { title: "reads", kind: "text", cell: (row) => row.read || "–" },
    { title: "member for", kind: "number", cell: (row) => membership(row) },
  ], ""),
  links: new Table("links", [
    { title: "peer", cell: (row) => called(row.peer) },
    { title: "role", cell: (row) => row.role },
    { title: "state", cell: (row) => stateCell(row.state) },
    { title: "in/s", kind: "number", cell: (row) => rateText(linkRate(row, "arrived")) },
    { title: "out/s", kind: "number", cell: (row) => rateText(linkRate(row, "sent")) },
    { title: "drop/s", kind: "number", cell: (row) => dropCell(linkRate(row, "dropped")) },
    { title: "RTT", kind: "number", cell: (row) => rttText(row.rtt_us) },
    { title: "since", kind: "number", cell: (row) => (row.age_s === null ? "–" : spanText(row.age_s)) },
    { title: "plane", cell: (row) => row.plane || "–" },
    { title: "address or reason", cell: (row) => reach(row) },
  ], ""),
  names: new Table("names", [
    { title: "name", cell: (row) => called(row.name, true) },
    { title: "kind", cell: (row) => row.kind },
    { title: "from", cell: (row) => entities(row.writers) },
    { title: "to", cell: (row) => entities(row.readers) },
    { title: "frames/s, about", kind: "number", cell: (row) => nameRate(row) },
  ], ""),
  domains: new Table("domains", [
    { title: "domain", cell: (row) => called(row.domain) },
    { title: "kind", cell: (row) => row.kind },
    { title: "state", cell: (row) => stateCell(row.state) },
    { title: "ends in", kind: "number", cell: (row) => untilText(row.until, now) },
    { title: "detail", kind: "text", cell: (row) => row.detail },
  ], ""),
  counters: new Table("counters", [
    { title: "counter", kind: "mono", cell: ([counter]) => counter },
    { title: "frames", kind: "number", cell: ([, count]) => countText(count) },
    { title: "per second", kind: "number", cell: ([counter]) => counterRate(counter) },
  ], ""),
  events: new Table("events", [
    { title: "time", kind: "mono", cell: (row) => new Date(row.at_ms).toLocaleTimeString("en-GB") },
    { title: "event", cell: (row) => ({ text: row.kind, className: eventClass(row.kind) }) },
    { title: "detail", kind: "text", cell: (row) => row.what },
  ], "Nothing has happened since this page's program started."),
};

function entities({ rows, more }) {
  const names = rows.map((entity) => entity.label ?? entity.short).join(", ");
  return { text: more ? `${names} +${more}` : names || "–" };
}

function membership(row) {
  const left = untilText(row.until, now);
  return row.renews ? { text: `${left.text}, renews`, className: "" } : left;
}

function reach({ reason, address, via }) {
  if (reason) return { text: reason, className: "text" };
  // Over UDP, `via` is the address of this switch, which the top of the page has.
  return via.startsWith("udp") ? address.replace(/^udp:/, "") : `${address} ${via}`;
}

function dropCell(value) {
  return { text: rateText(value), className: value > 0 ? "bad-text" : "" };
}

function nameRate(row) {
  return row.frames === null ? { text: "–", className: "muted" } : rateText(rate(`name ${row.name.name}`));
}

function counterRate(counter) {
  const value = rate(`counter ${counter}`);
  return counter.startsWith("drop_") ? dropCell(value) : rateText(value);
}

function eventClass(kind) {
  return { "link up": "ok-text", "link down": "bad-text", "link refused": "warn-text", missed: "warn-text" }[kind] ?? "";
}

// The rates at the top, with their history.
const traffic = [
  ["forwarded", (counter) => ["forwarded", "replicated"].includes(counter)],
  ["delivered", (counter) => counter === "delivered"],
  ["dropped", (counter) => counter.startsWith("drop_")],
].map(([title, counts]) => {
  const box = element("div", `rate${title === "dropped" ? " drops" : ""}`);
  const [value, line] = [element("b", "", "…"), document.createElementNS(SVG, "svg")];
  line.setAttribute("viewBox", `0 0 ${HISTORY} 34`);
  line.setAttribute("preserveAspectRatio", "none");
  line.setAttribute("aria-hidden", "true");
  const points = document.createElementNS(SVG, "polyline");
  line.append(points);
  box.append(element("span", "", title), value, line);
  document.getElementById("rates").append(box);
  return { counts, box, value, points, history: [] };
});

function showTraffic(counters) {
  for (const { counts, box, value, points, history } of traffic) {
    const known = Object.keys(counters).filter(counts).map((counter) => rate(`counter ${counter}`));
    const sum = past.length < 2 ? undefined : known.reduce((total, one) => total + (one ?? 0), 0);
    setText(value, rateText(sum));
    box.classList.toggle("some", sum > 0);
    if (sum === undefined) continue;
    history.push(sum);
    if (history.length > HISTORY) history.shift();
    const top = Math.max(1, ...history);
    const start = HISTORY - history.length;
    points.setAttribute("points", history.map((one, i) => `${start + i},${32 - (30 * one) / top}`).join(" "));
  }
}

function showOwn(own) {
  const fields = own
    ? [
        ["switch", own.switch.label ?? own.switch.short],
        ["domain", own.domain ? (own.domain.label ?? own.domain.short) : "none"],
        ["plane", own.data_plane],
        ["UDP", own.udp ?? "off"],
        ["RIB", own.rib_here ? "here" : own.rib ? `at ${own.rib.label ?? own.rib.short}` : "unknown"],
        ["names", String(own.rib_names ?? own.fib_names)],
      ]
    : [];
  const list = document.getElementById("own");
  const key = JSON.stringify(fields);
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...fields.map(([term, text]) => {
    const group = element("div");
    group.append(element("dt", "", term), element("dd", "", text));
    return group;
  }));
}

function showProblems({ rows, more }) {
  const down = rows.filter((problem) => problem.severity === "down").length;
  const [panel, list] = [document.getElementById("problems"), document.querySelector("#problems ul")];
  const lines = more ? [...rows, { severity: "warning", what: `and ${more} more` }] : rows;
  const key = JSON.stringify(lines);
  if (panel.dataset.key !== key) {
    panel.dataset.key = key;
    panel.hidden = !lines.length;
    list.replaceChildren(...lines.map(({ severity, what }) => {
      const item = element("li", severity);
      item.append(element("b", "", severity === "down" ? "DOWN" : "Warning"), document.createTextNode(what));
      return item;
    }));
  }
  const warnings = rows.length - down + more;
  const words = [down && `${down} down`, warnings && `${warnings} ${warnings === 1 ? "warning" : "warnings"}`];
  verdict(down ? "down" : warnings ? "warning" : "ok", words.filter(Boolean).join(", ") || "Nothing is down");
}

function verdict(state, text) {
  document.body.className = state;
  setText(document.getElementById("verdict"), text);
  const title = state === "ok" ? "GDP" : `${text} – GDP`;
  if (document.title !== title) document.title = title;
}

function small(panel, text) {
  setText(document.querySelector(`#${panel} h2 small`), text);
}

let shown = -1;
// Older snapshots are no longer how things are.
const STALE_MS = 5000;

function show(snapshot) {
  if (snapshot.age_ms > STALE_MS) {
    verdict("down stale", `The daemon has not answered for ${spanText(snapshot.age_ms / 1000)}`);
  }
  // The same one again.
  if (snapshot.uptime_ms === shown) return;
  shown = snapshot.uptime_ms;
  now = snapshot.at_ms / 1000;
  remember(snapshot);
  showOwn(snapshot.switch);
  showProblems(snapshot.problems);
  const { nodes, edges, links, names, domains, robots, switch: own } = snapshot;
  const rates = new Map();
  for (const link of links.rows.filter(({ role, state }) => role !== "endpoint" && state === "up")) {
    const [arrived, sent] = ["arrived", "sent"].map((count) => rateText(linkRate(link, count)));
    rates.set(link.peer.name, `in ${arrived}/s · out ${sent}/s`);
  }
  map.show(nodes.rows, edges, rates);
  small("topology", own ? `${own.reached} of ${own.switches} switches reached` : "");
  setText(document.querySelector("#topology figcaption"), nodes.more ? `and ${nodes.more} more switches` : "");
  tables.robots.explain(
    snapshot.robots_error ?? (robots ? "No robot has joined. gdp-ctl invite lets one in."
      : "The domain's members are listed on the machine where gdp-ctl up runs."));
  tables.robots.show(robots ?? { rows: [], more: 0 }, (row) => rowClass(row.state));
  const online = robots?.rows.filter((row) => row.state === "online").length;
  small("robots", robots ? `${online} of ${robots.rows.length + robots.more} online` : "");
  const silent = "The daemon does not answer.";
  tables.links.explain(own ? "This switch has no links. gdp-ctl invite lets a robot in." : silent);
  tables.names.explain(own ? "Nobody publishes or reads anything." : silent);
  tables.domains.explain(own ? "This switch belongs to no domain. gdp-ctl up makes one." : silent);
  tables.counters.explain(own ? "No frame has arrived yet." : silent);
  tables.links.show(links, (row) => rowClass(row.state));
  small("links", !own ? "" : `${links.rows.filter((row) => row.state === "up").length} up`);
  tables.names.show(names);
  small("names", !own ? "" : own.rib_here ? "in the RIB" : "at this switch");
  tables.domains.show(domains, (row) => rowClass(row.state));
  const counters = Object.entries(snapshot.counters).filter(([, count]) => count > 0);
  tables.counters.show({ rows: counters, more: 0 });
  tables.events.show({ rows: snapshot.events, more: 0 });
  showTraffic(snapshot.counters);
  setText(document.getElementById("clock"), new Date(snapshot.at_ms).toLocaleTimeString("en-GB"));
}

let failingSince = null;

// What the server says is wrong.
class Reason extends Error {}

async function refresh() {
  try {
    const response = await fetch("/api/snapshot", { signal: AbortSignal.timeout(8000) });
    if (response.status === 401) throw new Reason("The token is another one now: open the address that gdp-ctl web printed");
    if (!response.ok) throw new Reason((await response.text()).trim());
    show(await response.json());
    failingSince = null;
  } catch (error) {
    failingSince ??= new Date();
    const since = failingSince.toLocaleTimeString("en-GB");
    const known = error instanceof Reason ? error.message : "gdp-ctl web does not answer";
    verdict("down stale", `${known}, since ${since}`);
  }
}

// Waits for each answer before the next question, so that a slow daemon is not asked more.
async function run() {
  for (;;) {
    const begun = performance.now();
    if (!document.hidden) await refresh();
    await new Promise((done) => setTimeout(done, Math.max(100, PERIOD_MS - (performance.now() - begun))));
  }
}

const found = document.getElementById("found");

async function trace(name) {
  const button = document.querySelector("#ask button");
  button.disabled = true;
  found.replaceChildren(element("p", "empty", "Asking the switches on the path…"));
  try {
    const response = await fetch(`/api/path?name=${encodeURIComponent(name)}`);
    if (!response.ok) throw new Error((await response.text()).trim());
    showPath(await response.json());
  } catch (error) {
    found.replaceChildren(element("p", "empty bad-text", error.message));
    map.mark([]);
  } finally {
    button.disabled = false;
  }
}

function showPath(answer) {
  found.replaceChildren();
  for (const error of [answer.query_error, answer.trace_error]) if (error) found.append(element("p", "empty", error));
  if (answer.trace_error && answer.trace.length) {
    found.append(element("p", "empty", "The path to where it is published:"));
  }
  if (answer.trace.length) {
    const lines = element("pre", "", answer.trace.join("\n"));
    lines.tabIndex = 0;
    found.append(lines);
  }
  new Table("found", [
    { title: "role", cell: (row) => row.role },
    { title: "entity", cell: (row) => called(row.entity) },
    { title: "at switch", cell: (row) => called(row.switch) },
    { title: "certificates", cell: (row) => row.verified
      ? { text: "verified", className: "ok-text" } : { text: "do not verify", className: "bad-text" } },
  ], "Nobody publishes or reads it.").show(answer.records);
  map.mark(answer.hops);
}

document.getElementById("ask").addEventListener("submit", (event) => {
  event.preventDefault();
  trace(document.getElementById("name").value.trim());
});
document.getElementById("names").addEventListener("click", (event) => {
  const name = event.target.dataset?.trace;
  if (!name) return;
  document.getElementById("name").value = name;
  document.getElementById("path").scrollIntoView({ block: "nearest" });
  trace(name);
});

// Two columns where there is room; narrow pages order the panels by style.
for (const panels of [["topology", "path", "traffic", "events"], ["robots", "links", "names", "domains", "counters"]]) {
  const column = element("div");
  column.append(...panels.map((panel) => document.getElementById(panel)));
  document.getElementById("panels").append(column);
}
run();
