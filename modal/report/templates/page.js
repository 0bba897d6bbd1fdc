"use strict";
(() => {
  // Reads values off the pictures of this page and moves the shapes. Nothing is loaded, and all text is set as text.
  const make = (name, parent, attributes = {}) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    return parent.appendChild(node);
  };
  const add = (name, parent, text = "", kind = "") => {
    const node = parent.appendChild(document.createElement(name));
    node.textContent = text;
    if (kind) node.className = kind;
    return node;
  };
  const told = add("p", document.body, "", "told");
  told.setAttribute("role", "status");
  const digits = (value) => {
    if (value === null || value === undefined) return "–";
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(2).replace("e", "·10^").replace("+", "");
    return String(Number(value.toPrecision(5)));
  };
  const share = (axis, value) => {
    const [low, high] = axis.limits;
    return axis.log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  };
  const value = (axis, part) => {
    const [low, high] = axis.limits;
    return axis.log ? low * (high / low) ** part : low + (high - low) * part;
  };
  const across = (panel, x) => panel.box[0] + share(panel.x, x) * panel.box[2];
  const down = (panel, y) => panel.box[1] + (1 - share(panel.y, y)) * panel.box[3];
  const at = (series, i) => (Array.isArray(series.x) ? series.x[i] : series.x.from + i * series.x.step);
  const nearest = (panel, series, x) => {
    if (!Array.isArray(series.x)) {
      return Math.max(0, Math.min(series.x.n - 1, Math.round((x - series.x.from) / series.x.step)));
    }
    let best = 0;
    for (let i = 1; i < series.y.length; i += 1) {
      if (Math.abs(series.x[i] - x) < Math.abs(series.x[best] - x)) best = i;
    }
    return best;
  };
  const withUnit = (axis, number) => `${digits(number)}${axis.unit ? ` ${axis.unit}` : ""}`;

  class Chart {
    constructor(figure) {
      this.figure = figure;
      this.panels = JSON.parse(figure.querySelector("script").textContent).panels;
      this.plot = figure.querySelector(".plot");
      this.svg = this.plot.querySelector("svg");
      this.hidden = new Set();
      this.over = make("g", this.svg, { class: "over" });
      this.tip = add("div", this.plot, "", "tip");
      this.tip.hidden = true;
      this.panel = this.panels[0];
      this.index = -1;
      if (!this.panels.length) return;
      this.keys();
      this.plot.tabIndex = 0;
      this.plot.setAttribute("role", "group");
      this.plot.setAttribute("aria-label", "Picture with values: the arrow keys read them, Escape ends");
      this.svg.addEventListener("pointermove", (event) => this.point(event));
      this.svg.addEventListener("pointerdown", (event) => this.point(event));
      this.svg.addEventListener("pointerleave", () => this.clear());
      this.plot.addEventListener("keydown", (event) => this.key(event));
      this.plot.addEventListener("blur", () => this.clear());
    }

    shape(series) {
      return document.getElementById(series.id)?.querySelector(":scope > path, use");
    }

    colour(series) {
      const shape = this.shape(series);
      if (!shape) return "currentColor";
      return shape.style.stroke && shape.style.stroke !== "none" ? shape.style.stroke : shape.style.fill;
    }

    keys() {
      const all = this.panels.flatMap((panel) => panel.series).filter((series) => this.shape(series));
      const names = [...new Set(all.map((series) => series.name))];
      if (names.length < 2) return;
      const row = document.createElement("div");
      row.className = "series toggles";
      row.setAttribute("role", "group");
      row.setAttribute("aria-label", "Series shown");
      this.figure.insertBefore(row, this.plot);
      for (const name of names) {
        const button = add("button", row, "");
        button.type = "button";
        const patch = add("i", button);
        const first = all.find((series) => series.name === name);
        patch.style.background = this.colour(first);
        const pale = this.shape(first).style.strokeOpacity;
        if (pale) patch.style.opacity = pale;
        add("span", button, name);
        button.setAttribute("aria-pressed", "true");
        button.addEventListener("click", () => {
          const off = !this.hidden.delete(name);
          if (off) this.hidden.add(name);
          button.setAttribute("aria-pressed", String(!off));
          for (const series of all.filter((one) => one.name === name)) {
            document.getElementById(series.id)?.classList.toggle("off", off);
          }
          this.clear();
        });
      }
      const title = this.svg.querySelector(".key[data-title]");
      if (title) add("span", row, `(${title.dataset.title})`);
    }

    shown(panel) {
      return panel.series.filter((series) => series.y && !this.hidden.has(series.name));
    }

    together(panel) {
      // A strip without a heading, such as a coherence, is read with the panel above it.
      const above = (one) => this.panels
        .filter((other) => other.head && Math.abs(other.box[0] - one.box[0]) < 2 && other.box[1] < one.box[1])
        .sort((a, b) => b.box[1] - a.box[1])[0];
      const first = panel.head ? panel : above(panel) ?? panel;
      return [first, ...this.panels.filter((other) => !other.head && other !== first && above(other) === first)];
    }

    point(event) {
      const matrix = this.svg.getScreenCTM();
      if (!matrix) return;
      const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
      const panel = this.panels.find(({ box }) =>
        x >= box[0] && x <= box[0] + box[2] && y >= box[1] && y <= box[1] + box[3]);
      if (!panel) {
        this.clear();
        return;
      }
      this.panel = panel;
      const points = this.points(panel);
      if (points.length) {
        const far = (one) => Math.hypot(one.left - x, one.top - y);
        const best = points.reduce((a, b) => (far(b) < far(a) ? b : a));
        if (far(best) < 14) this.showPoint(best);
        else this.clear();
        return;
      }
      this.showAt(value(panel.x, (x - panel.box[0]) / panel.box[2]));
    }

    points(panel) {
      return this.shown(panel).filter((series) => series.points).flatMap((series) => series.y.map((y, i) => {
        const x = at(series, i);
        return { series, i, x, y, left: across(panel, x), top: down(panel, y) };
      })).filter((one) => Number.isFinite(one.left) && Number.isFinite(one.top));
    }

    showPoint({ series, i, x, y, left, top }) {
      this.current = { series, i, x, y };
      const { panel } = this;
      this.over.replaceChildren();
      make("circle", this.over, { cx: left, cy: top, r: 6 });
      const rows = [[panel.y.what, withUnit(panel.y, y)]];
      for (const [k, number] of (series.rows ? series.rows[i] : []).entries()) {
        if (number !== null) rows.push([series.columns[k], digits(number)]);
      }
      this.write(`${panel.x.what} ${withUnit(panel.x, x)}`, rows, left, top);
    }

    showAt(x) {
      this.current = { x };
      const group = this.together(this.panel);
      this.over.replaceChildren();
      const rows = [];
      let place = x;
      for (const panel of group) {
        for (const series of this.shown(panel)) {
          const i = nearest(panel, series, x);
          const y = series.y[i];
          if (panel === this.panel) place = at(series, i);
          rows.push([series.name, y === null ? "–" : withUnit(panel.y, y), this.colour(series)]);
          const top = y === null ? NaN : down(panel, y);
          if (top >= panel.box[1] && top <= panel.box[1] + panel.box[3]) {
            make("circle", this.over, { cx: across(panel, at(series, i)), cy: top, r: 3.4 });
          }
        }
        const left = across(panel, x);
        make("line", this.over, { x1: left, x2: left, y1: panel.box[1], y2: panel.box[1] + panel.box[3] });
      }
      const { head, box } = this.panel;
      const title = group[0].head || head;
      const axis = group.find((one) => one.x.what)?.x ?? this.panel.x;
      const where = `${axis.what} ${withUnit(axis, place)}`.trim();
      this.write(title ? `${title}, ${where}` : where, rows, across(this.panel, x), box[1] + 8);
    }

    write(title, rows, left, top) {
      this.tip.replaceChildren();
      add("b", this.tip, title);
      for (const [name, text, colour] of rows) {
        const row = add("span", this.tip);
        if (colour) add("i", row).style.background = colour;
        add("em", row, name);
        add("strong", row, text);
      }
      this.tip.hidden = false;
      const scale = this.svg.getBoundingClientRect().width / this.svg.viewBox.baseVal.width;
      const width = this.tip.offsetWidth;
      const room = this.plot.scrollLeft + this.plot.clientWidth;
      const right = left * scale + 14;
      this.tip.style.left = `${right + width > room ? Math.max(0, left * scale - width - 14) : right}px`;
      const lowest = this.plot.clientHeight - this.tip.offsetHeight;
      this.tip.style.top = `${Math.max(0, Math.min(lowest, top * scale - 10))}px`;
      if (this.byKey) told.textContent = [title, ...rows.map(([name, text]) => `${name} ${text}`)].join(", ");
    }

    clear() {
      this.tip.hidden = true;
      this.over.replaceChildren();
      this.current = undefined;
    }

    key(event) {
      const { key } = event;
      if (!["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "Escape"].includes(key)) return;
      event.preventDefault();
      if (key === "Escape") {
        this.clear();
        return;
      }
      this.byKey = true;
      const points = this.points(this.panel);
      if (points.length) this.stepPoint(points, key);
      else this.stepLine(key, event.shiftKey ? 10 : 1);
      this.byKey = false;
    }

    stepPoint(points, key) {
      const now = this.current;
      const along = key === "ArrowUp" || key === "ArrowDown";
      const sign = key === "ArrowUp" || key === "ArrowRight" || key === "Home" ? 1 : -1;
      const left = now ? across(this.panel, now.x) : key === "ArrowLeft" || key === "End" ? Infinity : -Infinity;
      const top = now ? down(this.panel, now.y) : 0;
      if (!now || key === "Home" || key === "End") {
        this.showPoint(points.reduce((a, b) => (sign * (b.left - a.left) < 0 ? b : a)));
        return;
      }
      const beyond = points.filter((one) => (along ? sign * (top - one.top) > 0.01 : sign * (one.left - left) > 0.01));
      const far = (one) => (along
        ? Math.abs(one.top - top) + 3 * Math.abs(one.left - left)
        : Math.abs(one.left - left) + 3 * Math.abs(one.top - top));
      if (beyond.length) this.showPoint(beyond.reduce((a, b) => (far(b) < far(a) ? b : a)));
    }

    stepLine(key, size) {
      if (key === "ArrowUp" || key === "ArrowDown") {
        const turn = key === "ArrowDown" ? 1 : this.panels.length - 1;
        this.panel = this.panels[(this.panels.indexOf(this.panel) + turn) % this.panels.length];
        if (this.points(this.panel).length) {
          this.current = undefined;
          this.stepPoint(this.points(this.panel), "Home");
          return;
        }
      }
      const series = this.shown(this.panel)[0];
      if (!series) return;
      const last = series.y.length - 1;
      let i = this.current ? nearest(this.panel, series, this.current.x) : 0;
      if (this.current && key === "ArrowRight") i = Math.min(last, i + size);
      if (this.current && key === "ArrowLeft") i = Math.max(0, i - size);
      if (key === "Home") i = 0;
      if (key === "End") i = last;
      this.showAt(at(series, i));
    }
  }

  for (const figure of document.querySelectorAll("figure[data-chart]")) new Chart(figure);
})();
