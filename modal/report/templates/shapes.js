(() => {
  // Turns and moves the shapes of the modes: (real cos - imaginary sin) added to the nodes, seen from far away.
  const make = (name, parent, kind) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", name);
    if (kind) node.setAttribute("class", kind);
    return parent.appendChild(node);
  };
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;

  class Mover {
    constructor(figure) {
      Object.assign(this, JSON.parse(figure.querySelector("script").textContent));
      figure.hidden = false;
      this.mode = this.modes[0];
      this.view = [...this.home];
      this.phase = 0;
      this.running = !still;
      this.buttons(figure);
      this.svg = make("svg", figure);
      figure.insertBefore(this.svg, figure.querySelector("figcaption"));
      this.svg.setAttribute("tabindex", "0");
      this.svg.setAttribute("role", "img");
      this.draw();
      this.handle();
      this.name();
      this.seen = false;
      new IntersectionObserver(([entry]) => {
        this.seen = entry.isIntersecting;
        this.start();
      }).observe(this.svg);
    }

    buttons(figure) {
      const row = document.createElement("div");
      row.className = "series";
      row.setAttribute("role", "group");
      row.setAttribute("aria-label", "Mode in motion");
      figure.prepend(row);
      const button = (text, act) => {
        const made = row.appendChild(document.createElement("button"));
        made.type = "button";
        made.textContent = text;
        made.addEventListener("click", () => act(made));
        return made;
      };
      button(this.running ? "Pause" : "Play", (made) => {
        this.running = !this.running;
        made.textContent = this.running ? "Pause" : "Play";
        this.start();
      });
      const choices = this.modes.map((mode) => button(mode.name, (made) => {
        this.mode = mode;
        for (const one of choices) one.classList.toggle("on", one === made);
        for (const one of choices) one.setAttribute("aria-pressed", String(one === made));
        this.name();
        this.place();
      }));
      choices.forEach((one, i) => {
        one.classList.toggle("on", i === 0);
        one.setAttribute("aria-pressed", String(i === 0));
      });
    }

    name() {
      this.svg.setAttribute("aria-label", `Shape of the mode at ${this.mode.name} in motion; the arrow keys turn it`);
    }

    draw() {
      this.faces = this.surfaces.map(() => make("polygon", this.svg, "face"));
      const set = (kind) => this.lines.map(() => make("polyline", this.svg, kind));
      this.rest = set("rest");
      this.edges = [set("edge"), set("edge")];
      this.now = set("now");
      this.dots = this.nodes.length > 400 ? [] : this.nodes.map(() => make("circle", this.svg));
      this.unfit();
      for (const line of this.svg.children) line.setAttribute("vector-effect", "non-scaling-stroke");
      this.place();
    }

    fit() {
      // All modes at both extremes stay inside, and the picture does not jump while it is turned: it only grows.
      const chosen = this.mode;
      for (const mode of this.modes) {
        this.mode = mode;
        for (const node of [...this.nodesAt(1, 0), ...this.nodesAt(-1, 0)]) {
          node.forEach((value, k) => {
            this.low[k] = Math.min(this.low[k], value - 0.04);
            this.high[k] = Math.max(this.high[k], value + 0.04);
          });
        }
      }
      this.mode = chosen;
      const size = this.high.map((value, k) => value - this.low[k]);
      this.svg.setAttribute("viewBox", [...this.low, ...size].map((value) => value.toFixed(4)).join(" "));
      const dot = Math.min(0.012, 0.012 * Math.max(size[1], size[0] / 2.7));
      for (const one of this.dots) one.setAttribute("r", dot.toFixed(4));
    }

    unfit() {
      this.low = [Infinity, Infinity];
      this.high = [-Infinity, -Infinity];
    }

    flatten([x, y, z]) {
      const [turn, tilt] = this.view;
      const across = x * Math.cos(turn) - y * Math.sin(turn);
      const away = x * Math.sin(turn) + y * Math.cos(turn);
      return [across, -(z * Math.cos(tilt) + away * Math.sin(tilt))];
    }

    nodesAt(real, imaginary) {
      const { mode } = this;
      return this.nodes.map((node, i) => this.flatten(node.map((value, k) =>
        value + real * mode.real[i][k] - imaginary * mode.imaginary[i][k])));
    }

    place() {
      this.fit();
      const write = (shapes, parts, nodes) => shapes.forEach((shape, i) =>
        shape.setAttribute("points", parts[i].map((node) => nodes[node].map((v) => v.toFixed(4)).join(",")).join(" ")));
      write(this.rest, this.lines, this.nodesAt(0, 0));
      write(this.edges[0], this.lines, this.nodesAt(1, 0));
      write(this.edges[1], this.lines, this.nodesAt(-1, 0));
      this.frame();
    }

    frame() {
      const nodes = this.nodesAt(Math.cos(this.phase), Math.sin(this.phase));
      const points = (part) => part.map((node) => nodes[node].map((v) => v.toFixed(4)).join(",")).join(" ");
      this.now.forEach((shape, i) => shape.setAttribute("points", points(this.lines[i])));
      this.faces.forEach((shape, i) => shape.setAttribute("points", points(this.surfaces[i])));
      this.dots.forEach((dot, i) => {
        dot.setAttribute("cx", nodes[i][0].toFixed(4));
        dot.setAttribute("cy", nodes[i][1].toFixed(4));
      });
    }

    start() {
      if (this.timer || !this.running || !this.seen) return;
      let before;
      const step = (time) => {
        this.timer = 0;
        if (!this.running || !this.seen) return;
        this.phase = (this.phase + (before === undefined ? 0 : (time - before) / 260)) % (2 * Math.PI);
        before = time;
        this.frame();
        this.timer = requestAnimationFrame(step);
      };
      this.timer = requestAnimationFrame(step);
    }

    turn(turn, tilt) {
      this.view = [this.view[0] + turn, Math.max(-1.57, Math.min(1.57, this.view[1] + tilt))];
      this.place();
    }

    handle() {
      let held;
      this.svg.addEventListener("pointerdown", (event) => {
        held = [event.clientX, event.clientY];
        this.svg.setPointerCapture(event.pointerId);
      });
      this.svg.addEventListener("pointermove", (event) => {
        if (!held) return;
        this.turn((held[0] - event.clientX) / 160, (event.clientY - held[1]) / 160);
        held = [event.clientX, event.clientY];
      });
      for (const end of ["pointerup", "pointercancel"]) this.svg.addEventListener(end, () => { held = undefined; });
      this.svg.addEventListener("dblclick", () => {
        this.view = [...this.home];
        this.unfit();
        this.place();
      });
      this.svg.addEventListener("keydown", (event) => {
        const steps = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
        if (!(event.key in steps)) return;
        event.preventDefault();
        this.turn(...steps[event.key]);
      });
    }
  }

  for (const figure of document.querySelectorAll("figure[data-shapes]")) new Mover(figure);
})();
