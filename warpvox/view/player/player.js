// State, controls and the loop that draws.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];
const PLAY = "M7 4v16l13-8z", PAUSE = "M6 4h4v16H6zM14 4h4v16h-4z";
const byId = (id) => document.getElementById(id);

class Player {
  constructor({ meta, envs }) {
    Object.assign(this, { meta, envs, last: meta.frames - 1, boxes: [], zoom: 1, pan: null, pointer: null, drag: null });
    const wish = new URLSearchParams(location.hash.slice(1));
    this.time = this.clampTime(Number(wish.get("frame")) || 0);
    this.chosen = Math.min(envs.length - 1, Math.max(0, Math.floor(Number(wish.get("robot")) || 0)));
    this.many = envs.length > 1 && wish.get("view") !== "one";
    this.speed = 1;
    this.playing = !wish.has("paused") && !matchMedia("(prefers-reduced-motion: reduce)").matches && this.last > 0;
    const points = Math.max(...envs.map((env) => env.scene.points));
    this.style = { colourOf: makeColours(meta), buffer: new Float32Array(points * 2), theme: null };
    this.timeline = new Timeline(envs);
    this.chooseTheme(wish.get("theme"));
    this.fillIn();
    this.listen();
    this.sync();
    requestAnimationFrame((now) => this.tick(now));
  }

  // ------------------------------------------------------------------ commands

  get env() { return this.envs[this.chosen]; }
  get frame() { return Math.floor(this.time); }
  clampTime(time) { return Math.min(this.last, Math.max(0, time)); }

  seek(frame) { this.time = this.clampTime(frame); this.sync(); }
  pause() { this.playing = false; this.sync(); }
  step(count) { this.playing = false; this.seek(this.frame + count); }

  toggle() {
    if (!this.playing && this.time >= this.last) this.time = 0;
    this.playing = !this.playing && this.last > 0;
    this.sync();
  }

  setSpeed(speed) { this.speed = speed; this.sync(); }

  shiftSpeed(by) {
    this.setSpeed(SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, SPEEDS.indexOf(this.speed) + by))]);
  }

  choose(number) {
    this.chosen = (number + this.envs.length) % this.envs.length;
    this.pan = null;
    this.sync();
  }

  showMany(many) { this.many = many && this.envs.length > 1; this.pan = null; this.sync(); }

  follow(on) {
    const box = this.boxes.find(({ env }) => env === this.env);
    this.pan = on || !box ? null : { x: box.look.left + box.look.w / 2, y: box.look.bottom + box.look.h / 2 };
    this.sync();
  }

  zoomBy(factor) { this.zoom = factor ? Math.min(8, Math.max(0.1, this.zoom * factor)) : 1; this.sync(); }

  chooseTheme(name) {
    const system = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
    document.documentElement.dataset.theme = name === "dark" || name === "light" ? name : system;
    this.style.theme = readTheme();
    this.dirty = true;
  }

  // ----------------------------------------------------------------------- page

  fillIn() {
    const { about, dt, colours, names } = this.meta, count = this.envs.length;
    const moves = ({ cells }) => cells.includes(3) || cells.includes(4);
    const robots = this.envs.flatMap((env) => env.scene.objects).filter(moves).length;
    const said = [about.rules && `rules ${about.rules}`, about.agent && `agent ${about.agent}`];
    said.push(robots && `${robots} robot${robots > 1 ? "s" : ""}`, `${(this.last * dt).toFixed(1)} s`);
    byId("about").textContent = said.filter(Boolean).join(" · ");
    const used = new Set(this.envs.flatMap((env) => env.scene.objects.flatMap((object) => object.cells)));
    for (const cell of [...used].sort()) {
      const item = document.createElement("li"), swatch = document.createElement("i");
      swatch.style.background = `linear-gradient(90deg, ${colours[cell].map((c) => `rgb(${c})`).join(",")})`;
      item.append(swatch, names[cell]);
      byId("legend").append(item);
    }
    SPEEDS.forEach((speed) => byId("speed").add(new Option(`${speed}×`, speed)));
    this.envs.forEach((env) => byId("robot").add(new Option(env.name, env.number)));
    byId("timeline").setAttribute("aria-valuemax", this.last);
    byId("layout").hidden = byId("robot").parentElement.hidden = count === 1;
  }

  // Show the state in the controls, and draw at the next opportunity.
  sync() {
    this.dirty = true;
    byId("play-icon").setAttribute("d", this.playing ? PAUSE : PLAY);
    byId("play").setAttribute("aria-label", this.playing ? "Pause" : "Play");
    byId("speed").value = this.speed;
    byId("robot").value = this.chosen;
    byId("follow").checked = !this.pan;
    byId("layout").textContent = this.many ? "One robot" : "All robots";
    byId("stage").classList.toggle("many", this.many);
  }

  listen() {
    const on = (id, event, action) => byId(id).addEventListener(event, action);
    on("play", "click", () => this.toggle());
    on("first", "click", () => this.seek(0));
    on("back", "click", () => this.step(-1));
    on("on", "click", () => this.step(1));
    on("speed", "change", (event) => this.setSpeed(Number(event.target.value)));
    on("robot", "change", (event) => this.choose(Number(event.target.value)));
    on("follow", "change", (event) => this.follow(event.target.checked));
    on("layout", "click", () => this.showMany(!this.many));
    on("theme", "click", () => this.toggleTheme());
    on("help", "click", () => byId("keys").showModal());
    const dark = matchMedia("(prefers-color-scheme: dark)");
    dark.addEventListener("change", () => this.chooseTheme());
    addEventListener("resize", () => { this.dirty = true; });
    addEventListener("keydown", (event) => this.onKey(event));
    this.listenToTimeline();
    this.listenToStage();
  }

  toggleTheme() { this.chooseTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"); }

  listenToTimeline() {
    const line = byId("timeline");
    let resume = false;
    const scrub = (event) => {
      const box = line.getBoundingClientRect();
      this.seek(Math.round(((event.clientX - box.left) / box.width) * this.last));
    };
    line.addEventListener("pointerdown", (event) => {
      line.setPointerCapture(event.pointerId);
      resume = this.playing;
      this.playing = false;
      scrub(event);
    });
    line.addEventListener("pointermove", (event) => { if (line.hasPointerCapture(event.pointerId)) scrub(event); });
    line.addEventListener("lostpointercapture", () => { this.playing = resume; this.sync(); });
  }

  listenToStage() {
    const stage = byId("stage");
    const place = (event) => {
      const box = stage.getBoundingClientRect();
      return { x: event.clientX - box.left, y: event.clientY - box.top };
    };
    const letGo = () => {
      this.drag = null;
      stage.classList.remove("dragging");
    };
    stage.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      stage.setPointerCapture(event.pointerId);
      this.drag = { ...place(event), moved: false };
    });
    stage.addEventListener("pointermove", (event) => {
      this.pointer = place(event);
      this.dirty = true;
      if (this.drag && !this.many) this.dragTo(this.pointer);
    });
    stage.addEventListener("pointerup", (event) => {
      const hit = this.drag && !this.drag.moved && this.boxUnder(place(event));
      letGo();
      if (hit && this.many) { this.choose(hit.env.number); this.showMany(false); }
    });
    stage.addEventListener("pointercancel", letGo);
    stage.addEventListener("pointerleave", () => { this.pointer = null; this.dirty = true; });
    stage.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoomBy(Math.exp(-event.deltaY / 600));
    }, { passive: false });
  }

  dragTo({ x, y }) {
    const dx = x - this.drag.x, dy = y - this.drag.y, box = this.boxes[0];
    if (!this.drag.moved && Math.hypot(dx, dy) < 4) return;
    byId("stage").classList.add("dragging");
    if (!this.pan) this.follow(false);
    this.pan = { x: this.pan.x - dx / box.look.scale, y: this.pan.y + dy / box.look.scale };
    this.drag = { x, y, moved: true };
    this.sync();
  }

  onKey(event) {
    const { key, ctrlKey, metaKey, altKey, shiftKey, target } = event;
    if (ctrlKey || metaKey || altKey || byId("keys").open || target.matches("select")) return;
    const far = shiftKey ? 10 : 1;
    const actions = {
      " ": () => this.toggle(), ArrowLeft: () => this.step(-far), ArrowRight: () => this.step(far),
      Home: () => this.seek(0), End: () => this.step(this.last),
      ArrowUp: () => this.shiftSpeed(1), ArrowDown: () => this.shiftSpeed(-1),
      n: () => this.choose(this.chosen + 1), p: () => this.choose(this.chosen - 1),
      g: () => this.showMany(!this.many), f: () => this.follow(Boolean(this.pan)), t: () => this.toggleTheme(),
      "+": () => this.zoomBy(1.25), "=": () => this.zoomBy(1.25), "-": () => this.zoomBy(0.8), 0: () => this.zoomBy(0),
      "?": () => byId("keys").showModal(),
    };
    const action = actions[key.length === 1 ? key.toLowerCase() : key];
    // A focused button would be pressed by the space bar as well.
    if (action) { event.preventDefault(); action(); }
  }

  // -------------------------------------------------------------------- drawing

  tick(now) {
    const seconds = Math.min(0.1, (now - (this.before ?? now)) / 1000);
    this.before = now;
    if (this.playing) {
      this.time += (seconds * this.speed) / this.meta.dt;
      if (this.time > this.last) this.time = 0;
      this.dirty = true;
    }
    if (this.dirty) { this.dirty = false; this.draw(); }
    requestAnimationFrame((next) => this.tick(next));
  }

  draw() {
    const { g, w, h, ratio } = this.prepare(byId("stage"));
    this.boxes = this.arrange(w, h);
    const { theme } = this.style;
    g.fillStyle = theme.page;
    g.fillRect(0, 0, w, h);
    for (const box of this.boxes) {
      box.look = lookAt(box.env, this.time, box, this.zoom, this.many ? null : this.pan);
      drawEnv(g, box.env, this.time, box, box.look, this.style, ratio);
      if (this.many) drawLabel(g, box.env, box, this.time, theme, box.env === this.env);
    }
    this.timeline.draw(this.prepare(byId("timeline")), this.env, this.time, theme);
    byId("timeline").setAttribute("aria-valuenow", this.frame);
    const { dt } = this.meta;
    byId("clock").textContent = `${(this.frame * dt).toFixed(2)} / ${(this.last * dt).toFixed(2)} s · frame ${this.frame}`;
    byId("return").textContent = this.env.returns[this.frame].toFixed(2);
    this.showTip();
  }

  prepare(canvas) {
    const ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight, g = canvas.getContext("2d");
    const width = Math.round(w * ratio), height = Math.round(h * ratio);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    return { g, w, h, ratio };
  }

  // Boxes of the environments: one, or all in the arrangement whose tiles come nearest to 16:10.
  arrange(w, h) {
    if (!this.many) return [{ env: this.env, x: 0, y: 0, w, h }];
    const count = this.envs.length, gap = 2;
    const fit = (columns) => Math.min(w / columns / 16, h / Math.ceil(count / columns) / 10);
    let columns = 1;
    for (let c = 2; c <= count; c++) if (fit(c) > fit(columns)) columns = c;
    const tw = (w + gap) / columns - gap, th = (h + gap) / Math.ceil(count / columns) - gap;
    return this.envs.map((env, i) => (
      { env, x: (i % columns) * (tw + gap), y: Math.floor(i / columns) * (th + gap), w: tw, h: th }
    ));
  }

  boxUnder({ x, y }) {
    return this.boxes.find((box) => x >= box.x && x < box.x + box.w && y >= box.y && y < box.y + box.h);
  }

  showTip() {
    const tip = byId("tip"), at = this.pointer, box = at && !this.drag?.moved && this.boxUnder(at);
    const found = box && cellAt(
      box.env, this.time,
      box.look.left + (at.x - box.x) / box.look.scale, box.look.bottom + (box.y + box.h - at.y) / box.look.scale,
      this.style.buffer,
    );
    tip.hidden = !found;
    if (!found) return;
    const name = document.createElement("b"), text = document.createElement("span");
    name.textContent = this.meta.names[found.cell];
    text.textContent = `stretch ${found.stretch.toFixed(2)} · ${found.object}, row ${found.row}, column ${found.column}`;
    tip.replaceChildren(name, text);
    const right = at.x + 16 + tip.offsetWidth > byId("stage").clientWidth;
    tip.style.left = `${right ? at.x - 12 - tip.offsetWidth : at.x + 16}px`;
    tip.style.top = `${Math.max(4, at.y - tip.offsetHeight - 8)}px`;
  }
}

readRollout().then((rollout) => { globalThis.player = new Player(rollout); }).catch((error) => {
  byId("note").hidden = false;
  byId("note").textContent = `The rollout cannot be shown: ${error.message}`;
  throw error;
});
