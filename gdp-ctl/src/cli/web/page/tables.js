// Tables that are updated in place, so that focus, selection and scrolling stay. Texts become text
// nodes, never markup.
"use strict";

function element(tag, className, text) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

function setText(of, text) {
  if (of.textContent !== text) of.textContent = text;
}

// A table in a panel. A column is {title, kind, cell}, where `cell` returns a text, or
// {text, className, small, name}.
class Table {
  constructor(panel, columns, empty) {
    this.panel = document.getElementById(panel);
    this.columns = columns;
    this.scroll = element("div", "scroll");
    this.scroll.tabIndex = 0;
    this.scroll.setAttribute("role", "region");
    this.scroll.setAttribute("aria-labelledby", `${panel}-title`);
    const table = element("table");
    table.setAttribute("aria-labelledby", `${panel}-title`);
    const head = element("tr");
    for (const { title, kind } of columns) {
      const cell = element("th", kind === "number" ? "number" : "", title);
      cell.scope = "col";
      head.append(cell);
    }
    const top = element("thead");
    top.append(head);
    this.body = element("tbody");
    table.append(top, this.body);
    this.scroll.append(table);
    this.none = element("p", "empty", empty);
    this.rest = element("p", "more");
    this.panel.append(this.scroll, this.none, this.rest);
  }

  // Shows the rows of a bounded list. `mark` returns the class of a row.
  show({ rows, more }, mark = () => "") {
    while (this.body.rows.length > rows.length) this.body.deleteRow(-1);
    rows.forEach((row, i) => {
      let line = this.body.rows[i];
      if (!line) {
        line = this.body.insertRow();
        for (const { kind } of this.columns) line.insertCell().dataset.kind = kind ?? "";
      }
      const className = mark(row);
      if (line.className !== className) line.className = className;
      this.columns.forEach((column, j) => fill(line.cells[j], column.cell(row)));
    });
    this.scroll.hidden = rows.length === 0;
    this.none.hidden = rows.length > 0;
    this.rest.hidden = more === 0;
    setText(this.rest, `and ${more} more`);
  }

  explain(text) {
    setText(this.none, text);
  }
}

function fill(cell, value) {
  const { text, className = "", small, name } = typeof value === "object" && value !== null ? value : { text: value };
  const wanted = [cell.dataset.kind, className].filter(Boolean).join(" ");
  if (cell.className !== wanted) cell.className = wanted;
  const key = JSON.stringify([text, small, name]);
  if (cell.dataset.key === key) return;
  cell.dataset.key = key;
  if (!small && !name) {
    cell.textContent = text ?? "–";
    return;
  }
  const parts = [];
  if (name) {
    const button = element("button", "name", text);
    button.type = "button";
    button.title = `Trace ${name}`;
    button.dataset.trace = name;
    parts.push(button);
  } else {
    parts.push(document.createTextNode(text));
  }
  if (small) parts.push(element("small", "", small));
  const hadFocus = cell.contains(document.activeElement);
  cell.replaceChildren(...parts);
  if (hadFocus) cell.querySelector("button")?.focus();
}

// A name as people read it: its label with the digits behind, or the digits alone.
function called({ name, short, label }, traces = false) {
  const cell = label ? { text: label, small: short } : { text: short, className: "mono" };
  return traces ? { ...cell, name } : cell;
}

function rateText(rate) {
  if (rate === undefined || rate === null) return "…";
  if (rate >= 1e6) return `${(rate / 1e6).toFixed(2)} M`;
  if (rate >= 1e4) return `${(rate / 1e3).toFixed(1)} k`;
  return rate > 0 && rate < 10 ? rate.toFixed(1) : String(Math.round(rate));
}

function countText(count) {
  return count.toLocaleString("en").replaceAll(",", "\u202f");
}

function rttText(us) {
  return us === null ? "–" : us < 10000 ? `${(us / 1000).toFixed(2)} ms` : `${Math.round(us / 1000)} ms`;
}

function spanText(seconds) {
  for (const [size, unit] of [[86400, "d"], [3600, "h"], [60, "min"]]) {
    if (seconds >= 2 * size) return `${Math.floor(seconds / size)} ${unit}`;
  }
  return `${Math.max(0, Math.floor(seconds))} s`;
}

function untilText(until, now) {
  if (until === null) return { text: "–", className: "muted" };
  const left = until - now;
  if (left <= 0) return { text: "ended", className: "bad-text" };
  return { text: spanText(left), className: left < 7 * 86400 ? "warn-text" : "" };
}
